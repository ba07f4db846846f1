"""Causes that explain readings equally well: which ones, what tells them apart by brute force, and stops that do so come first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.diagnosis.policy import CLEAR_LOG_EVIDENCE
from estimator.planning.splitting import ENOUGH, Split, credible
from estimator.planning.unseen import Unseen

N_OWN, N_STOPS, SIZE = 3, 40, 0.8
RIGHT, RIVAL = N_OWN, N_OWN + 1


def judged(size: list[float], sd: list[float]) -> Unseen:
    """Quantities of a usual size of 1."""
    ones = torch.ones(len(size), dtype=torch.float64)
    return Unseen([], torch.tensor(sd).double(), torch.tensor(size).double(), ones, ones == 0.0)


def test_the_credible_set_holds_causes_each_by_its_leading_quantity():
    causes = ["gain", "gain", "shear", "tilt"]
    alike = judged([0.50, 0.51, 0.505, 0.1], [0.1] * 4)
    assert credible(alike, causes) == [1, 2]
    assert credible(judged([0.5, 0.8, 0.5, 0.1], [0.1] * 4), causes) == [1]
    assert credible(judged([0.1, 0.2, 0.2, 0.1], [0.1] * 4), causes) == []  # nothing is there for certain
    assert credible(judged([], []), []) == []


@pytest.fixture
def split() -> tuple[Split, torch.Tensor]:
    """Two quantities of which readings so far show nearly the same, while some candidates tell them apart; and these readings."""
    rng = np.random.default_rng(6)
    seen = torch.from_numpy(rng.normal(size=(60, N_OWN + 2)))
    seen[:, RIVAL] = seen[:, RIGHT] + 0.1 * seen[:, RIVAL]
    columns = torch.from_numpy(rng.normal(size=(1, N_STOPS, 3, N_OWN + 2)))
    columns[..., RIVAL] = columns[..., RIGHT] + 0.05 * columns[..., RIVAL]
    columns[0, 17, :, RIVAL] = -columns[0, 17, :, RIGHT]
    prior = torch.tensor([0.1] * N_OWN + [1.0, 1.0], dtype=torch.float64)
    precision = (seen.T @ seen + torch.diag(prior))[None]
    return Split(
        ("a", "b"), (SIZE, SIZE), (RIGHT, RIVAL), torch.arange(N_OWN), prior, precision, columns
    ), seen


def left(split: Split, readings: torch.Tensor, right: int, rival: int) -> float:
    """Half of what a fit with the rival leaves of readings that only the right cause changes, priors included."""
    chosen = [*range(N_OWN), rival]
    rows = torch.cat((readings[:, chosen], torch.diag(split.prior[chosen].sqrt())))
    shown = torch.cat((SIZE * readings[:, right], torch.zeros(len(chosen), dtype=torch.float64)))
    fitted = rows @ torch.linalg.lstsq(rows, shown).solution
    return 0.5 * float((shown - fitted).square().sum())


def test_expected_evidence_is_what_a_fit_with_the_rival_leaves(split):
    chosen, seen = split
    now, after = chosen.evidence
    pairs = ((RIGHT, RIVAL), (RIVAL, RIGHT))
    assert now == pytest.approx(min(left(chosen, seen, *pair) for pair in pairs), rel=1e-9)
    for stop in (0, 17):
        readings = torch.cat((seen, chosen.columns[0, stop]))
        expected = min(left(chosen, readings, *pair) for pair in pairs)
        assert float(after[stop]) == pytest.approx(expected, rel=1e-9)
    assert int(chosen.gains.argmax()) == 17


def test_causes_are_told_apart_only_while_stops_are_expected_to(split):
    chosen, _ = split
    best = float(chosen.gains.max())
    needed = (CLEAR_LOG_EVIDENCE - chosen.evidence[0]) / best
    assert chosen.is_open(1.01 * needed)
    assert not chosen.is_open(0.99 * needed)
    larger = replace(chosen, sizes=(10.0 * SIZE, 10.0 * SIZE))
    assert larger.evidence[0] > ENOUGH
    assert not larger.is_open(100.0)  # these readings should have told them apart
