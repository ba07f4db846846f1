"""The place from which something acts, between the coarse places that it starts from."""

from __future__ import annotations

import math

import pytest

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.hypotheses.places import at_known_place, at_nearer_place
from estimator.diagnosis.hypotheses.screening import Screened, screening
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

IRON, OFFSET = Cause("iron_body", "room"), Cause("sensor_offset", "hall")
TRUE_PLACE = {"x_m": 0.03, "y_m": -0.02, "z_m": 0.05}


@pytest.fixture
def plain(small_rig: Rig, small_session: Session) -> Fit:
    """A fit without the piece of iron that answers in the readings."""
    given = {"volume_m3": 2e-5, **TRUE_PLACE}
    return fit_of(small_rig, with_wrong(small_rig, small_session.observations, IRON, given))


def _screened(fit: Fit, cause: Cause) -> Screened:
    return screening(fit, candidates(fit, [cause]))[cause]


def _from_truth_m(screened: Screened) -> float:
    return math.dist([screened.start.shapes[key] for key in TRUE_PLACE], TRUE_PLACE.values())


def test_a_compass_search_comes_nearer_to_the_true_place_and_finds_more_evidence_there(plain: Fit) -> None:
    coarse = _screened(plain, IRON)
    nearer = at_nearer_place(plain, coarse)
    assert _from_truth_m(coarse) > 0.03
    assert _from_truth_m(nearer) < 0.01
    assert nearer.highest > 1.2 * coarse.highest
    assert nearer.log_bayes_factor == coarse.log_bayes_factor


def test_a_place_where_it_was_found_before_is_better_than_a_coarse_one_or_is_not_taken(plain: Fit) -> None:
    coarse = _screened(plain, IRON)

    def reached(place: dict[str, float]) -> dict[str, object]:
        return {f"{IRON.label}.{key}": plain.vector.new_tensor(value) for key, value in place.items()}

    at_truth = at_known_place(plain, coarse, reached(TRUE_PLACE))
    assert _from_truth_m(at_truth) == 0.0
    assert at_truth.highest > coarse.highest
    far_off = {key: 10.0 * value for key, value in TRUE_PLACE.items()}
    assert at_known_place(plain, coarse, reached(far_off)) is coarse


def test_what_has_no_place_stays_as_it_is(plain: Fit) -> None:
    coarse = _screened(plain, OFFSET)
    assert at_nearer_place(plain, coarse) == coarse
    assert at_known_place(plain, coarse, {}) is coarse
