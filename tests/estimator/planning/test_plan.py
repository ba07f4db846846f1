"""Plans before any reading: what is in the file, what is refused, and what the order costs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
import torch

from estimator import InvalidInput, plan, simulate
from estimator.acquisition.pace import Pace, default_pace, durations_s
from estimator.planning.goals import goal_of
from estimator.planning.planned import Planned, tour
from estimator.readings.plan import Plan, plan_from_text
from estimator.rig.parameters import Normal
from estimator.rig.rig import Rig

GOAL = "field 1 % in box x_mm=-20:20 y_mm=-20:20 z_mm=-10:10"


@pytest.fixture(scope="module")
def both_signs(small_plan: Plan) -> Plan:
    return replace(small_plan, currents_A=({"coil1": 3.0}, {"coil1": -3.0}, {}))


@pytest.fixture(scope="module")
def planned(small_rig: Rig, both_signs: Plan) -> Planned:
    return plan(small_rig, both_signs, [GOAL], n_stops=40)


def test_the_file_holds_all_kinds_of_stops_each_with_its_reason(planned):
    lines = planned.text.partition("stops:\n")[2].splitlines()
    assert len(lines) == len(planned.stops) == len(planned.reasons) == 40
    for line, reason in zip(lines, planned.reasons, strict=True):
        assert line.endswith(f"  # {reason}")
    kinds = {reason.split(":")[0] for reason in planned.reasons}
    assert kinds == {"informs", "held out", "no current", "again, from the other side"}
    current_A = planned.stops.current_A[:, 0]
    is_on, is_held_out = current_A != 0.0, planned.stops.is_validation
    assert abs(int((current_A > 0.0).sum()) - int((current_A < 0.0).sum())) <= 8
    assert [r.startswith("no current") for r in planned.reasons] == (~is_on).tolist()
    assert [r.startswith("held out") for r in planned.reasons] == is_held_out.tolist()
    assert 3 <= int(is_held_out.sum()) <= 6


def test_the_file_is_read_as_it_was_planned(planned, small_rig):
    readings = simulate(small_rig, plan_from_text(planned.text, small_rig), {}, seed=1)
    assert readings.is_validation.tolist() == planned.stops.is_validation.tolist()
    torch.testing.assert_close(readings.current_A, planned.stops.current_A)
    torch.testing.assert_close(readings.motion["arm1"], planned.stops.motion["arm1"], rtol=0.0, atol=1e-7)


def test_what_a_calibration_of_the_stops_cannot_tell_from_the_coils_is_named(planned, small_rig, small_plan):
    """With the Earth's field and one current, 1 of 12 promised half-widths held the error; with both signs 10."""
    one_current = replace(small_plan, currents_A=({"coil1": 3.0},))
    names = ("background_field[room]", "sensor_offset[hall]")
    assert plan(small_rig, one_current, [GOAL], n_stops=20).not_told == names
    assert planned.not_told == ()


def test_held_out_stops_are_none_of_the_fit(planned):
    key = torch.cat((planned.stops.current_A, planned.stops.motion["arm1"]), dim=1)
    held_out, fitted = key[planned.stops.is_validation], key[~planned.stops.is_validation]
    assert not (held_out[:, None] == fitted).all(-1).any()


def test_intervals_never_widen_and_the_number_of_stops_follows_from_the_goal(planned, small_rig, both_signs):
    (widths,) = planned.expected
    assert all(later <= earlier + 1e-9 for earlier, later in pairwise(widths))
    assert all(
        later == earlier
        for (earlier, later), is_held_out in zip(
            pairwise(widths), planned.stops.is_validation[1:], strict=True
        )
        if is_held_out
    )
    needed = planned.n_needed
    assert needed is not None
    assert widths[needed - 1] <= 1.0 < widths[needed - 2]
    found = plan(small_rig, both_signs, [GOAL.replace("1 %", "0.3 %")])
    assert found.expected[0][-1] <= 1.0
    assert found.n_needed is not None
    assert 0.5 * len(found.stops) < found.n_needed


def test_random_order_has_the_same_stops_and_takes_longer(planned, small_rig, both_signs):
    shuffled = plan(small_rig, both_signs, [GOAL], n_stops=40, order="random")
    assert sorted(shuffled.text.splitlines()) == sorted(planned.text.splitlines())
    assert shuffled.duration_s > planned.duration_s
    assert planned.duration_s == pytest.approx(sum(planned.times_s))
    pace = default_pace(small_rig, both_signs.settle_s)
    assert durations_s(shuffled.stops, small_rig, pace) == pytest.approx(list(shuffled.times_s))


def test_repeats_come_from_the_other_side(planned):
    n_back = sum(reason.startswith("again") for reason in planned.reasons)
    assert n_back >= 3
    places = [tuple(place) for place in planned.stops.motion["arm1"].tolist()]
    back = list(dict.fromkeys(places[-n_back:]))
    assert [place for place in dict.fromkeys(places[:-n_back]) if place in back] == back[::-1]


def test_a_tour_visits_all_and_is_shorter(small_rig, small_plan):
    stops = simulate(small_rig, small_plan, {}, seed=1)
    shuffled = stops.rows(torch.randperm(len(stops), generator=torch.Generator().manual_seed(0))).alone
    pace = Pace(0.1, 10, 1.0, {"arm1": 0.01}, {"coil1": 1.0})
    way = tour(shuffled, small_rig, pace)
    assert sorted(way) == list(range(len(stops)))
    along = shuffled.rows(torch.tensor(way)).alone
    assert sum(durations_s(along, small_rig, pace)) < 0.6 * sum(durations_s(shuffled, small_rig, pace))


def test_a_goal_out_of_reach_is_refused_with_what_would_be_reached(small_rig, both_signs):
    gain = replace(small_rig.parameters["coil1.current_gain"], prior=Normal(1.0, 0.05))
    with pytest.raises(
        InvalidInput, match=r"100 visits to each of them would leave \d.* times its half-width"
    ):
        plan(small_rig.with_parameters([gain]), both_signs, ["parameters coil1.current_gain 0.1 %"])


def test_too_many_stops_for_a_goal_are_refused(small_rig, both_signs):
    with pytest.raises(InvalidInput, match="must need at most 500 stops; these leave"):
        plan(small_rig, both_signs, [GOAL.replace("1 %", "0.02 %")])


def test_fewer_candidates_than_unknowns_are_refused(small_rig):
    places = plan_from_text(
        "{schema_version: 1, name: none, stops: [{arm1: {y_mm: 48, z_mm: 44}, current_A: {coil1: 3}}]}",
        small_rig,
    )
    with pytest.raises(
        InvalidInput, match=r"as many numbers as the rig has unknowns, 3; 0 numbers .*1 of 1 may lie"
    ):
        plan(small_rig, places, [GOAL])
    with pytest.raises(InvalidInput, match="must be given a number of stops or a goal"):
        plan(small_rig, places)


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("weather", "begin with"),
        ("field 0.2 in box x_mm=0:1", "half-width > 0 in % or in T"),
        ("field -1 % in box x_mm=0:1", "half-width > 0"),
        ("field 1 mm in box x_mm=0:1", "half-width > 0 in % or in T"),
        ("field 1 % in room x_mm=0:1", "box, ball or points"),
        ("field 1 % in box x_T=0:1", "with lengths"),
        ("field 1 % in box x_mm=a:1", "finite numbers"),
        ("field 1 % in box r_mm=3", "for a ball alone"),
        ("field 1 % in ball x_mm=3", "state r for a ball"),
        ("parameters coil1.radius_m 1 A", "half-width > 0 in % or in m"),
        ("parameters coil1.raduis_m 1 mm", "the closest is coil1.radius_m"),
        ("parameters coil1.radius_m 0 mm", "half-width > 0"),
    ],
)
def test_what_is_no_goal_is_refused_with_examples(text, rule, small_rig):
    with pytest.raises(InvalidInput, match=rule) as error:
        goal_of(text, small_rig, {"coil1": 3.0})
    assert "such as 'field 0.2 % in box" in str(error.value)
    assert text in str(error.value)


def test_a_workspace_in_a_winding_is_refused(small_rig, both_signs):
    with pytest.raises(InvalidInput, match="workspace must lie outside the windings; 72 of its 72 points"):
        plan(small_rig, both_signs, ["field 1 % in box y_mm=48 z_mm=-45"], n_stops=10)


def test_a_seed_repeats_the_plan(planned: Planned, small_rig: Rig, both_signs: Plan) -> None:
    assert plan(small_rig, both_signs, [GOAL], n_stops=40).text == planned.text
