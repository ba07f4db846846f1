"""The shortest session that decides whether a calibration holds: few stops, error rates kept, what changed is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.acquisition.acquire import Choice
from estimator.acquisition.pace import default_pace
from estimator.calibration.result import Calibration
from estimator.effects.attach import with_effect
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.candidates import clear_candidates
from estimator.planning.decision import Limits
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.recalibration.changes import Changes
from estimator.recalibration.recheck import CHANGED, HOLDS, UNDECIDED, Recheck
from estimator.recalibration.sequential import Rates
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Cause, Rig
from tests.estimator.planning.measured import World

NOISE_T = 5e-6
SHARE = 0.02
MOST_STOPS = 40
N_SESSIONS = 12


@pytest.fixture(scope="module")
def stops(small_rig: Rig, small_plan: Plan) -> Observations:
    places = replace(small_plan, currents_A=({"coil1": 3.0}, {"coil1": -3.0}, {}))
    return clear_candidates(places, small_rig, 0)


@pytest.fixture(scope="module")
def asked(small_calibration: Calibration, stops: Observations) -> Recheck:
    return recheck(small_calibration, stops)


def recheck(
    calibration: Calibration, stops: Observations, most_stops: int = MOST_STOPS, share: float = SHARE
) -> Recheck:
    pace = default_pace(calibration.rig, 0.1)
    return Recheck(calibration, stops, share, pace, Limits(most_stops), Rates())


def world(
    pilot: Recheck, stops: Observations, truth: Mapping[str, float], seed: int, **hidden: float
) -> World:
    return World.of(pilot.rig, pilot, truth, NOISE_T, seed, hidden, stops)


@pytest.mark.whole
def test_a_calibration_that_holds_is_called_changed_at_the_stated_rate_at_most(
    asked, small_calibration, stops
):
    truths = small_calibration.draw_values(N_SESSIONS)
    ends, lengths = [], []
    for k in range(N_SESSIONS):
        truth = {name: float(truths[name][k]) for name in small_calibration.draws}
        entries, end = world(asked, stops, truth, k).run()
        ends.append(end.outcome)
        lengths.append(len(entries))
    assert ends.count(CHANGED) <= 1  # two have a probability of 1 % at the stated rate of 1 %
    assert ends.count(HOLDS) >= 0.8 * N_SESSIONS
    assert np.median(lengths) < 30  # a scatter of less than the noise needs most of them


@pytest.mark.whole
@pytest.mark.parametrize(
    ("moved", "hidden", "name"),
    [
        ({"coil1.world_from_coil0.z_m": 1e-3}, {}, "coil1.world_from_coil0.z_m"),
        ({}, {"axis_gain[hall].x": 0.03}, "axis_gain[hall].x"),
        ({}, {"background_field[room].x_T": 80e-6}, "background_field[room].x_T"),
    ],
)
def test_what_changed_is_named_with_its_size(asked, small_calibration, stops, moved, hidden, name):
    names = list(small_calibration.draws)
    truth = {n: small_calibration.best[n] + moved.get(n, 0.0) for n in names}
    entries, end = world(asked, stops, truth, 5, **hidden).run()
    assert end.outcome == CHANGED
    assert len(entries) < 15
    (size,) = [words.split(" by ")[1] for words in end.leading if words.startswith(f"{name} by ")]
    assert float(size.split()[0]) == pytest.approx({**moved, **hidden}[name], rel=0.5)


def test_what_the_calibration_knows_of_the_currents_before_is_no_change(small_rig, small_truth, stops):
    """A core keeps 3 % of the last current, as the rig says."""
    memory, sizes = Cause("current_remanence", "coil1"), {"share": 0.03}
    rig = with_effect(small_rig.with_values(small_truth), memory, stops, sizes, is_free=False)
    best, rng = rig.nominal_values(), np.random.default_rng(7)
    spread = {p.name: 0.0 if p.is_count else 1e-5 for p in rig.free}
    draws = {name: best[name] + sd * rng.normal(size=(1, 400)) for name, sd in spread.items()}
    pilot = recheck(Calibration(rig, stops, best, draws, np.zeros((1, 400)), {}), stops)
    rows = rng.permutation(len(stops))[:20]
    visited = replace(stops.rows(torch.from_numpy(rows)).alone, time_s=torch.arange(20.0).double())
    visits = world(pilot, stops, {}, 3)
    visits.field_T[rows, 0] = MeasurementModel.build(rig, visited).predict(nominal_tensors(rig))
    entries = [
        visits.entry(Choice(row, False, 0, 0.0, 0.0, {"decision": {"row": row}}), number)
        for number, row in enumerate(rows.tolist())
    ]
    assert pilot.decide(entries).outcome != CHANGED


@pytest.mark.whole
def test_stops_are_the_same_after_a_restart(asked, small_calibration, stops):
    truth = {name: small_calibration.best[name] for name in small_calibration.draws}
    entries, end = world(asked, stops, truth, 6).run()
    again = recheck(small_calibration, stops)
    assert again.decide(entries) == end
    for n in (0, len(entries) // 2):
        choice = again.choose(entries[:n])
        assert choice is not None
        assert choice.record == {"decision": entries[n]["decision"]}
    refused = again.choose(entries[:1], [entries[1]["decision"]["row"]])
    assert refused is not None
    assert refused.row != entries[1]["decision"]["row"]


@pytest.mark.whole
def test_it_is_undecided_at_its_limit_and_leaves_out_what_stops_do_not_show(small_calibration, stops):
    short = recheck(small_calibration, stops, most_stops=4)
    truth = {name: small_calibration.best[name] for name in small_calibration.draws}
    entries, end = world(short, stops, truth, 7).run()
    assert (len(entries), end.outcome) == (4, UNDECIDED)
    assert set(short.changes.left_out) > set(recheck(small_calibration, stops).changes.left_out)


def test_what_moves_the_field_by_rounding_alone_is_no_change(asked, stops):
    """The turn of a round coil about its axis: a size of 1e14 rad would be as large as any change, and never be excluded."""
    candidates, number = asked.expansion.whitened(stops.with_field(torch.zeros_like(stops.field_sensor_T))), 3
    rounded = candidates.columns.clone()
    rounded[:, number] *= 1e-16
    changes = Changes.of(asked.expansion, replace(candidates, columns=rounded), SHARE, 1.0, 0.05)
    name = asked.expansion.names[number]
    assert name in asked.changes.names
    assert name not in changes.names + changes.left_out


@pytest.mark.whole
def test_changes_that_no_stop_shows_are_refused(small_calibration, stops):
    with pytest.raises(InvalidInput, match="must be large enough to show at the candidate stops"):
        recheck(small_calibration, stops, share=1e-5)
