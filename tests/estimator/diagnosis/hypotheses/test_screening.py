"""Full fits of single causes, and what of a cause is asked alone."""

from __future__ import annotations

import pytest
import torch

from estimator.diagnosis.hypotheses.candidates import Candidate, at_starts, candidates
from estimator.diagnosis.hypotheses.screening import in_full, linear_evidence, screening
from estimator.effects.causes.sensor import SensorOffset
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

OFFSET = Cause("sensor_offset", "hall")


@pytest.mark.parametrize("is_itself", [True, False])
def test_fit_that_has_left_its_cause_is_no_evidence_for_it(
    small_rig: Rig, small_session: Session, monkeypatch, is_itself
):
    """A cause that is no longer itself has no evidence, though it explains much."""
    monkeypatch.setattr(SensorOffset, "is_itself", lambda *_: is_itself)
    plain = fit_of(small_rig, with_wrong(small_rig, small_session.observations, OFFSET, {"x_T": 100e-6}))
    value, _, start = screening(plain, candidates(plain, [OFFSET]))[OFFSET]
    assert value > 20.0
    log_bayes_factor, full = in_full(plain, value, start)
    assert full.log_evidence - plain.log_evidence > 20.0
    assert (log_bayes_factor > 20.0) is is_itself
    assert is_itself or log_bayes_factor == 0.0


@pytest.mark.parametrize(
    ("keys", "alone"),
    [
        (
            tuple(f"segment{n}_{axis}_T" for n in (0, 4) for axis in "xyz"),
            {(0, 1, 2), (3, 4, 5), (0, 1, 3, 4), (0, 2, 3, 5), (1, 2, 4, 5)},
        ),
        (tuple(f"segment{n}_gain" for n in range(3)), set()),
        (tuple("xyz"), set()),
    ],
)
def test_one_segment_and_all_but_one_quantity_are_asked_besides_singles_and_pairs(
    keys: tuple[str, ...], alone: set[tuple[int, ...]]
) -> None:
    n = len(keys)
    none = torch.zeros(n, dtype=torch.float64)
    subsets = Candidate(Cause("any", "hall"), {}, keys, keys, none, torch.diag(none), none).subsets
    assert len(set(subsets)) == len(subsets)
    assert subsets[-1] == tuple(range(n))
    assert {subset for subset in subsets[:-1] if len(subset) > 2} == alone


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_what_cannot_be_negative_explains_nothing_where_it_would_have_to_be(
    small_rig: Rig, small_session: Session, side: float
) -> None:
    """Iron draws a field together; readings with the opposite answer are no iron, however well a negative piece of it would fit."""
    right = small_session.observations
    iron = Cause("iron_body", "room")
    wrong = with_wrong(small_rig, right, iron, {"volume_m3": 2e-5, "x_m": 0.03, "y_m": -0.02, "z_m": 0.05})
    change_T = wrong.field_sensor_T - right.field_sensor_T
    plain = fit_of(small_rig, right.with_field(right.field_sensor_T + side * change_T))
    there = at_starts(plain, iron, [{"x_m": 0.03, "y_m": -0.02, "z_m": 0.05}])
    (value,) = linear_evidence(plain, there)
    assert value > 20.0 if side > 0.0 else value == 0.0


def test_a_bump_is_asked_from_every_instant_as_a_prediction_from_that_instant_says(
    small_rig: Rig, small_session: Session
) -> None:
    """One prediction serves all instants, though the sensor sits elsewhere in other readings from each of them."""
    plain = fit_of(small_rig, small_session.observations)
    bumped = Cause("sensor_bumped", "hall")
    circumstances = plain.posterior.model.circumstances
    starts = [{"since_h": instant_h} for instant_h in circumstances.instants_h]
    together = at_starts(plain, bumped, starts)
    alone = [candidate for start in starts for candidate in at_starts(plain, bumped, [start])]
    assert len(together) == len(alone) > 2
    moved = [int(candidate.columns.abs().sum(1).count_nonzero()) for candidate in together]
    assert sorted(moved, reverse=True) == moved
    assert moved[0] > moved[-1] > 0
    for shared, itself in zip(together, alone, strict=True):
        assert shared.shapes == itself.shapes
        assert torch.allclose(shared.columns, itself.columns, rtol=1e-12, atol=0.0)
        assert torch.allclose(shared.shift, itself.shift, atol=1e-9)
