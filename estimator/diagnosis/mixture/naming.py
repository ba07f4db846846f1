"""The causes that an answer states, as a verdict lists them, and fits of the rig with them."""

from __future__ import annotations

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.found import Found
from estimator.diagnosis.mixture.full_fits import fit_with
from estimator.diagnosis.next_readings.expected_evidence import rows_seen, separation
from estimator.diagnosis.verdict import Alternative, NamedCause
from estimator.rig.rig import Cause
from estimator.side_by_side import each


def named_by(answer: Answer) -> list[NamedCause]:
    """The stated causes, surest first, each with its alternatives and what else it may be."""
    return [_named(answer, entry) for entry in answer.stated]


def _named(answer: Answer, found: Found) -> NamedCause:
    listed = [possibility for possibility in found.possibilities if possibility.is_listed]
    first, *others = listed
    fits = alternative_fits(answer, found) if others else {}
    return NamedCause(
        first.cause,
        found.probability * first.share,
        tuple(
            Alternative(p.cause, found.probability * p.share, _expected(fits, first.cause, p.cause))
            for p in others
        ),
        answer.in_place_of(found).log_bayes_factor([first.cause]),
        1.0 - found.probability * found.listed_share,
        found.family,
    )


def _expected(fits: dict[Cause, Fit], truth: Cause, other: Cause) -> float:
    """Expected log evidence of these readings for one cause, were it true, against another."""
    two = {truth.label: fits[truth], other.label: fits[other]}
    return float(separation(two, rows_seen(two))[0])


def alternative_fits(answer: Answer, found: Found) -> dict[Cause, Fit]:
    """Fits of the rig with each listed possibility of a set, beside the other stated causes."""
    others = [entry.first_listed for entry in answer.stated if entry != found]
    fits = each(lambda cause: fit_with(answer, [*others, cause]), found.listed)
    return dict(zip(found.listed, fits, strict=True))


def fitted_with_stated(answer: Answer) -> Fit:
    """The rig as described with the stated causes, fitted to the readings that were asked."""
    return fit_with(answer, [entry.first_listed for entry in answer.stated])
