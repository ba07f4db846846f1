"""What readings say of goals and of candidates: no stop promises more than its like have given, and a design lessens what is judged."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch

from estimator.acquisition.acquire import Choice
from estimator.acquisition.pace import default_pace
from estimator.planning.autopilot import Autopilot, pilot_of
from estimator.planning.candidates import clear_candidates
from estimator.planning.decision import Limits
from estimator.planning.judgement import judge
from estimator.planning.so_far import SoFar
from estimator.planning.unseen import Unseen
from estimator.readings.plan import load_plan
from estimator.rig_files.read import load_rig
from tests.estimator.planning.measured import World

GOAL = "field 0.3 % in box x_mm=-50:50 y_mm=-50:50 z_mm=-25:25"
N_CHOSEN, N_VISITS = 12, 30


@pytest.fixture(scope="module")
def measured() -> tuple[Autopilot, list[dict[str, Any]]]:
    """The paper's coil, with chosen stops and then one of them again and again."""
    rig = load_rig("configs/paper_simulation.yaml")
    places = replace(load_plan("configs/plans/recommended.yaml", rig), validation=())
    pilot = pilot_of(
        rig, clear_candidates(places, rig, 0), [GOAL], default_pace(rig, 0.1), Limits(200), seed=0
    )
    truth = {"coil1.radius_m": 0.0505, "coil1.world_from_coil0.z_m": -0.041}
    hidden = {"cross_axis[hall].xz": 0.01}
    world = World.of(pilot.rig, pilot, truth, 2e-5, 1, hidden)
    entries: list[dict[str, Any]] = []
    for number in range(N_CHOSEN):
        choice = pilot.choose(entries)
        assert choice is not None
        entries.append(world.entry(choice, number))
    same = Choice(pilot.rows[-1], False, 0, 1.0, 1.0, {})
    entries += [world.entry(same, N_CHOSEN + number) for number in range(N_VISITS)]
    return pilot, entries


@pytest.mark.whole
def test_no_stop_promises_more_than_its_like_have_given(measured):
    pilot, entries = measured
    pilot.decide(entries)
    precisions, row = pilot.so_far.products().precision_of_draws, pilot.rows[-1]
    added = pilot.so_far.model.every.information(torch.tensor([row]))
    assert pilot.rows.count(row) >= N_VISITS
    root = torch.linalg.cholesky(precisions)
    whitened = torch.linalg.solve_triangular(root, added, upper=False)
    shares = torch.linalg.eigvalsh(torch.linalg.solve_triangular(root, whitened.mT, upper=False))
    assert float(shares.max()) <= 1.0 / N_VISITS * (1.0 + 1e-6)
    assert float(shares.min(0).values.max()) > 0.5 / len(entries)  # the stop shows something at every draw


@pytest.mark.whole
def test_a_design_lessens_the_variance_that_is_judged(measured):
    pilot, entries = measured
    pilot.decide(entries[:9])  # after which the candidates are linearised at the estimate
    so_far, judged = pilot.so_far, judge(pilot.so_far)
    products, own = so_far.products(), so_far.own
    unseen = Unseen.of(
        products.information, products.score, products.prior, so_far.wanted(), own, so_far.is_usual
    )
    names = [so_far.coordinates.names[i] for i in so_far.known.tolist()]
    assert judged.cause.startswith("cross_axis[hall].xz")
    column = names.index(judged.cause.partition(" of ")[0])
    variance_left = float(unseen.variance[int((~own)[:column].sum())])
    covariance = torch.linalg.inv(judged.expected.precision[0])
    place = int(own[:column].sum())
    assert float(covariance[place, place]) == pytest.approx(variance_left, rel=1e-6)


def test_a_field_of_the_room_that_one_current_cannot_tell_is_there_for_certain(measured):
    """Taken for one of forty rare causes, the Earth's field broke 4 of 21 promises; taken for certain, 1 of 20."""
    rig = load_rig("configs/paper_simulation.yaml")
    stops = clear_candidates(load_plan("configs/plans/paper_grid.yaml", rig), rig, 0)
    so_far = pilot_of(rig, stops, [GOAL], default_pace(rig, 0.1), Limits(50), seed=0).so_far
    names = _besides(so_far)
    usual = [name for name, is_usual in zip(names, so_far.is_usual.tolist(), strict=True) if is_usual]
    assert {"background_field[room].x_T", "sensor_offset[hall].z_T"} <= set(usual) < set(names)
    assert not any(
        name.startswith("background_field") for name in _besides(measured[0].so_far)
    )  # fitted there


def _besides(so_far: SoFar) -> list[str]:
    """Quantities that a fit leaves out."""
    return [so_far.coordinates.names[i] for i in so_far.known[~so_far.own].tolist()]
