"""The stops of a plan, the instruments that it needs, and how long it takes."""

from __future__ import annotations

import pytest
import torch

from estimator.acquisition.pace import Pace, check_instruments, digest_of, durations_s, stops_of
from estimator.errors import InvalidInput
from estimator.readings.plan import Plan, Stop
from estimator.rig_files.read import load_rig


def test_a_plan_without_its_instruments_is_refused(small_rig, stops):
    names = {"sensors": {"hall"}, "sources": {"coil1"}, "arms": {"arm1"}}
    check_instruments(stops, small_rig, names)
    for kind, name in (("sources", "coil1"), ("arms", "arm1")):
        with pytest.raises(InvalidInput, match=f"one for {name}, which the plan uses"):
            check_instruments(stops, small_rig, {**names, kind: set()})
    with pytest.raises(InvalidInput, match="must have a sensor"):
        check_instruments(stops, small_rig, {**names, "sensors": set()})


def test_few_readings_cannot_tell_whether_the_field_has_settled():
    with pytest.raises(InvalidInput, match="pace.n_readings must be at least 6"):
        Pace(0.0, 5, 1.0, {}, {})


def test_durations_count_travel_ramps_and_readings(small_rig, stops):
    pace = Pace(1.0, 10, 5.0, {"arm1": 0.01}, {"coil1": 2.0})
    # travel of 0, 0 and 20 mm at 10 mm/s, ramps of 3, 6 and 0 A at 2 A/s, ten readings of 20 ms
    assert durations_s(stops, small_rig, pace) == pytest.approx([0.3 + 1.5 + 1.2, 3.0 + 1.2, 0.3 + 2.0 + 1.2])


def test_a_stop_is_one_row_for_any_number_of_sensors(small_plan, small_rig):
    assert len(stops_of(small_plan, small_rig, 0)) == 27 + 9
    mice = load_rig("configs/mice_ssu_e1_cc_e2.yaml")
    pose = {"mapper": torch.zeros(6).numpy()}
    plan = Plan("two", (), (), (), "raster", 1, 1.0, (Stop(pose, {"E1": 1.0}), Stop(pose, {"E1": 2.0})))
    assert stops_of(plan, mice, 0).current_A[:, 0].tolist() == [1.0, 2.0]


def test_stops_have_a_digest_that_changes_with_them(small_plan, small_rig):
    stops = stops_of(small_plan, small_rig, 0)
    assert digest_of(stops) == digest_of(stops_of(small_plan, small_rig, 1))  # this plan has a fixed order
    assert digest_of(stops) != digest_of(stops.rows(torch.arange(len(stops) - 1)))
