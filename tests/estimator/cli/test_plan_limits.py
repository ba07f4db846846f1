"""A plan is judged by what the coils have carried before it, and only by the stops that are left."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import Refused
from drivers.limits_section import RigLimits
from drivers.safety import ArmLimits, CoilLoad, CurrentLimits
from estimator.acquisition.pace import Pace, stops_of
from estimator.cli.plan_limits import check_currents, check_ways, loads_so_far
from estimator.readings.observations import Observations
from estimator.readings.plan import load_plan
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig

LIMITS = RigLimits(
    currents={"coil1": CurrentLimits(-5.0, 5.0, 10.0, continuous_A=3.0, thermal_time_constant_s=100.0)}
)
TIMES_S = [30.0, 30.0]
"""At 5 A, a cold coil bears 44.6 s."""


@pytest.fixture
def stops(small_rig: Rig, tmp_path: Path) -> Observations:
    path = tmp_path / "plan.yaml"
    path.write_text(
        "schema_version: 1\nname: hot\nsettle_s: 0.1\nstops:\n"
        "- {arm1: {x_mm: 10}, current_A: {coil1: 5}}\n- {arm1: {x_mm: 10}, current_A: {coil1: -5}}\n",
        encoding="utf-8",
    )
    return stops_of(load_plan(path, small_rig), small_rig, seed=0)


def test_stops_that_were_visited_are_not_counted_again(small_rig, stops):
    with pytest.raises(Refused, match="stop 2 of the plan, coil1: .* may flow for 14.6 s"):
        check_currents(stops, small_rig, LIMITS, TIMES_S)
    check_currents(stops, small_rig, LIMITS, TIMES_S, n_before=1)


def test_what_they_left_in_the_coil_is(small_rig, stops):
    records = [{"time_s": 30.0, "current_A": [5.0]}]
    warm = loads_so_far(records, small_rig, LIMITS, now_s=31.0)
    with pytest.raises(Refused, match="stop 2 of the plan, coil1"):
        check_currents(stops, small_rig, LIMITS, TIMES_S, n_before=1, loads=warm)
    cooled = loads_so_far(records, small_rig, LIMITS, now_s=1000.0)
    check_currents(stops, small_rig, LIMITS, TIMES_S, n_before=1, loads=cooled)


def test_a_pause_between_two_runs_is_no_stop(small_rig):
    """Of the pause only what a stop takes, 1 s here, may still have carried current; the coil was warm by 10 s of 5 A."""
    records = [
        {"time_s": 1.0, "begin_s": 0.0, "end_s": 1.0, "current_A": [0.0]},
        {"time_s": 1e5, "begin_s": 1e5 - 10.0, "end_s": 1e5, "current_A": [5.0]},
    ]
    (load,) = loads_so_far(records, small_rig, LIMITS, now_s=1e5).values()
    assert load.mean_square_A2 == pytest.approx(25.0 * (1.0 - math.exp(-0.1)), rel=1e-3)
    assert loads_so_far([], small_rig, LIMITS, now_s=0.0)["coil1"] == CoilLoad(0.0, 0.0)


def test_where_an_arm_goes_is_checked_before_it_is_asked_where_it_stands(small_rig, stops):
    box = ArmLimits((-0.005, -1.0, -1.0), (0.005, 1.0, 1.0), highest_speed_m_per_s=0.1)
    limits = RigLimits(arms={"arm1": box})
    pace = Pace(0.1, 6, 1.0, {"arm1": 0.05}, {})
    check_ways(stops, small_rig, limits, pace, {})  # its displacements count from where it stands
    absolute = replace(small_rig, movers=tuple(replace(m, motion=MotionKind.POSE) for m in small_rig.movers))
    with pytest.raises(Refused, match="stop 1 of the plan, arm1: arm.target.x_m must be within"):
        check_ways(stops, absolute, limits, pace, {})
    with pytest.raises(Refused, match="arm.speed_m_per_s must be > 0 and at most 0.1; received 0.2"):
        check_ways(stops, absolute, limits, replace(pace, speed_m_per_s={"arm1": 0.2}), {})
