"""Stops chosen while a session is measured: the same ones after a restart, fewer than a raster, and no promise that readings contradict."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from estimator.acquisition.pace import default_pace
from estimator.model.room_field import RoomField
from estimator.planning.autopilot import FEWEST_HELD_OUT, Autopilot, pilot_of
from estimator.planning.candidates import clear_candidates
from estimator.planning.decision import Decision, Limits
from estimator.planning.judgement import Misfit
from estimator.planning.next_stop import next_stop
from estimator.readings.plan import Plan
from estimator.rig.rig import Rig
from estimator.store.growing import observations_of
from tests.estimator.planning.measured import World

GOAL = "field 0.15 % in box x_mm=-20:20 y_mm=-20:20 z_mm=-10:10"
TRUTH = {"coil1.radius_m": 0.0518, "coil1.axial_loops": 12.6, "coil1.world_from_coil0.z_m": -0.0425}
NOISE_T = 5e-6
Run = tuple[Autopilot, list[dict[str, Any]], Decision]


@pytest.fixture(scope="module")
def places(small_plan: Plan) -> Plan:
    return replace(small_plan, currents_A=({"coil1": 3.0}, {"coil1": -3.0}, {}))


def pilot(rig: Rig, places: Plan, goal: str = GOAL, limits: Limits | None = None) -> Autopilot:
    stops = clear_candidates(places, rig, 0)
    return pilot_of(rig, stops, [goal], default_pace(rig, 0.1), limits or Limits(200), seed=0)


@pytest.fixture(scope="module")
def measured(small_rig: Rig, places: Plan) -> Run:
    chooser = pilot(small_rig, places)
    entries, end = World.of(small_rig, chooser, TRUTH, NOISE_T, seed=1).run()
    return chooser, entries, end


def true_error(rig: Rig, chooser: Autopilot, hidden_from: dict[str, float]) -> float:
    """Root mean square of the error of the field over the goal's workspace, over what the goal allows as a standard deviation."""
    (goal,) = chooser.goals
    fit = chooser.so_far.fit
    current_A = torch.tensor([3.0], dtype=torch.float64)
    fields_T = []
    for each, values in (
        (chooser.rig, fit.coordinates.values(fit.vector)),
        (
            rig,
            {n: torch.tensor(v).double() for n, v in rig.with_values(hidden_from).nominal_values().items()},
        ),
    ):
        room = RoomField(each, values, goal.points_m)
        fields_T.append(room.field_T(values, current_A) - room.field_T(values, 0.0 * current_A))
    estimated_T, true_T = fields_T
    share = (estimated_T - true_T).square().mean().sqrt() / true_T.square().sum(-1).mean().sqrt()
    return float(share) * 1.645 / goal.half_width


@pytest.mark.whole
def test_it_ends_when_held_out_stops_agree_and_the_promise_is_kept(measured, small_rig):
    chooser, entries, end = measured
    assert end.reason.startswith("goal reached, also by")
    assert max(end.widths) <= 1.0 < max(entries[len(entries) // 3]["decision"]["widths"])
    held_out = [entry for entry in entries if entry["is_validation"]]
    assert FEWEST_HELD_OUT <= len(held_out) < 0.5 * len(entries)
    assert len(entries) < 120
    assert true_error(small_rig, chooser, TRUTH) < 3.0


@pytest.mark.whole
def test_every_decision_is_the_same_after_a_restart(measured, small_rig, places):
    _, entries, end = measured
    for n in (0, 1, 2, 5, len(entries) // 2, len(entries) - 1):
        choice = pilot(small_rig, places).choose(entries[:n])
        assert choice is not None
        assert choice.record == {"decision": entries[n]["decision"]}
        assert (choice.is_validation, choice.repeat) == (entries[n]["is_validation"], entries[n]["repeat"])
    assert pilot(small_rig, places).decide(entries) == end


@pytest.mark.whole
def test_decisions_beside_the_readings_leave_the_session_readable(measured, small_rig):
    _, entries, _ = measured
    readings = observations_of(entries, small_rig)
    assert len(readings) == len(entries)
    words = {entry["decision"]["reason"].split(":")[0] for entry in entries}
    assert words >= {"informs", "held out", "again"}
    assert {
        "row",
        "reason",
        "widths",
        "misfit_T",
        "gain_per_s",
        "n_candidates",
        "left",
        "cause",
        "stated",
        "refused",
    } == set(entries[0]["decision"])


@pytest.mark.whole
def test_no_goal_is_reached_that_the_readings_contradict(small_rig, places):
    chooser = pilot(small_rig, places)
    world = World.of(small_rig, chooser, TRUTH, NOISE_T, seed=2, hidden={"axis_gain[hall].x": 0.05})
    entries, end = world.run()
    assert end.reason.startswith("floor reached: readings contradict the model")
    assert max(end.widths) > 1.0
    assert len(entries) < 100


@pytest.mark.whole
@pytest.mark.parametrize(
    ("limits", "n_stops", "words"),
    [(Limits(6), 6, "limit of 6 stops"), (Limits(200, 5.5), 5, "limit of 0.0917 minutes")],
)
def test_it_ends_at_its_limits(small_rig, places, limits, n_stops, words):
    chooser = pilot(small_rig, places, limits=limits)
    entries, end = World.of(small_rig, chooser, TRUTH, NOISE_T, seed=3).run()
    assert len(entries) == n_stops
    assert end.reason.startswith(words)
    assert "times the wanted half-width is left" in end.reason


def test_what_readings_contradict_does_not_average_out():
    clean, contradicted = Misfit(0.0, 1e-6, 4, 4), Misfit(1e-6, 1e-6, 4, 4)
    assert clean.factor(1000, 3) == 1.0
    widths = [contradicted.factor(n, 3) / n**0.5 for n in (100, 400, 1600)]
    assert widths[2] == pytest.approx(widths[0], rel=0.01)


@pytest.mark.whole
def test_a_rig_that_others_drive_gets_the_same_stops(measured, small_rig, places):
    _, entries, _ = measured
    pace = default_pace(small_rig, 0.1)
    for n in (0, 5):
        readings = observations_of(entries[:n], small_rig) if n else None
        stop = next_stop(small_rig, places, [GOAL], readings, pace=pace)
        assert stop.decision.to_json() == entries[n]["decision"]
        assert stop.is_validation == entries[n]["is_validation"]
        assert stop.motion["arm1"] == entries[n]["motion"]["arm1"]
        assert stop.current_A == {"coil1": entries[n]["current_A"][0]}
    ended = next_stop(small_rig, places, [GOAL], observations_of(entries, small_rig), pace=pace)
    assert ended.decision.reason.startswith("goal reached")
    assert (ended.decision.row, ended.motion) == (None, {})


@pytest.mark.whole
def test_stops_that_are_refused_are_not_chosen_again(measured, small_rig, places):
    _, entries, _ = measured
    chooser = pilot(small_rig, places)
    first = chooser.choose(entries[:4])
    assert first is not None
    second = chooser.choose(entries[:4], [first.row])
    assert second is not None
    assert second.row != first.row
    assert second.record["decision"]["refused"] == (first.row,)
    record = {**entries[4], "decision": {**entries[4]["decision"], **second.record["decision"]}}
    assert chooser.decide([*entries[:4], record]).refused == (first.row,)  # by what is on disk
    everything = range(len(chooser.settings))
    assert (
        chooser.decide(entries[:4], everything).reason
        == f"no stop is left: instruments refused all {len(everything)}"
    )
    for n in range(8):  # held out, again and without current, too
        some = [row for row in everything if row % 2]
        assert chooser.decide(entries[:n], some).row not in some
