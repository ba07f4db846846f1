"""The fit that a diagnosis begins with: of the rig as described, to the readings that can have been measured as they were recorded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from estimator.diagnosis import effort, policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.far_elsewhere import rules_and_refusal
from estimator.diagnosis.hypotheses.record_mistakes import leaves_much_of_the_field
from estimator.diagnosis.lost_signs import lost_signs
from estimator.diagnosis.result import Diagnosis, Question
from estimator.diagnosis.robust_fit import robust_values
from estimator.diagnosis.single_readings import Suspects, some_miss_by_far, suspects_beside, suspects_of
from estimator.diagnosis.stale_poses import stale_poses
from estimator.errors import InvalidInput
from estimator.readings.digits import flags_of_digits
from estimator.readings.flags import Flag, merged, without_flagged
from estimator.readings.observations import Observations
from estimator.readings.split import thinned, with_validation
from estimator.store.session import Session

MOST_ROUNDS_OF_FLAGS = 3  # how often such readings are looked for, each time without those found before


@dataclass(frozen=True)
class FirstFit:
    """The rig as described, fitted to a session without the readings that were flagged.

    Attributes:
        question: What was asked.
        session: What was measured; flagged readings count as not measured.
        validation: Another session, which judges the fits.
        most_readings: That are fitted.
        flags: Readings that were left out.
        seen, unseen: Readings for the fits, and others that judge them.
        plain: The fit.
        refusal: Why the geometry as recorded is refused; None where it is not.
    """

    question: Question
    session: Session
    validation: Session | None
    most_readings: int
    flags: tuple[Flag, ...]
    seen: Observations
    unseen: Observations
    plain: Fit
    refusal: InvalidInput | None

    @classmethod
    def of(
        cls,
        question: Question,
        session: Session,
        validation: Session | None,
        most_readings: int,
        flags: Sequence[Flag] | None = None,
    ) -> FirstFit:
        """The fit without the readings that were flagged, by default those that are told without a fit."""
        if flags is None:
            flags = flags_of_digits(session.observations)
            left = without_flagged(session.observations, flags)
            signs = lost_signs(question.rig, left)
            if signs.flags:
                session_of_known = replace(session, observations=signs.without(left))
                rough = cls.of(question, session_of_known, validation, most_readings, ())
                flags = merged(left, (*flags, *lost_signs(question.rig, left, rough.plain).flags))
        session = replace(session, observations=without_flagged(session.observations, flags))
        seen, unseen = (_that_hold_something(part) for part in _split(session, validation, question.seed))
        few = thinned(seen, most_readings, question.seed)
        rules, refusal = rules_and_refusal(question.rig, few)
        plain = fit_rig(question.rig, few, {}, rules, effort.MORE_STARTS)
        return cls(question, session, validation, most_readings, tuple(flags), seen, unseen, plain, refusal)

    @property
    def measured(self) -> Session:
        """The session without readings of which nothing is left."""
        return replace(self.session, observations=_that_hold_something(self.session.observations))

    def suspects(self) -> Suspects:
        """Single readings that were recorded otherwise than they were measured."""
        readings = self.session.observations
        if self.refusal is None and (stale := stale_poses(self.plain, readings)):
            return Suspects(stale, False)
        is_odd = some_miss_by_far(self.plain, readings) or leaves_much_of_the_field(self.plain)
        if self.refusal is not None or not is_odd:
            return Suspects([], False)
        return suspects_of(self.plain, readings)

    def flags_by(self, result: Diagnosis) -> list[Flag]:
        """Such readings after a search, by the rig as described, else by the extended one."""
        readings = self.session.observations
        by_plain = [] if self.refusal is not None else suspects_of(self.plain, readings).flags
        extended = result.fits.extended
        return by_plain or suspects_beside(extended, robust_values(extended), readings).flags

    def judging(self, extended: Fit) -> tuple[Observations, list[Flag]]:
        """The readings that judge the fits, and what was flagged and left out of those of another session.

        Args:
            extended: Of the rig with the causes that were found.
        """
        if self.validation is None:
            return self.unseen, []
        readings = self.validation.observations
        before = flags_of_digits(readings)
        signs = lost_signs(extended.rig, without_flagged(readings, before), extended)
        before = merged(readings, (*before, *signs.flags))
        suspects = suspects_beside(extended, extended.values, without_flagged(readings, before))
        flags = merged(readings, before if suspects.may_be_causes else (*before, *suspects.flags))
        return without_flagged(readings, flags), flags

    def without_suspects(self, tell: Callable[[str], None]) -> FirstFit:
        """The fit without such readings, unless they may be a cause of the library; a finer fit shows finer mistakes."""
        first = self
        for _ in range(MOST_ROUNDS_OF_FLAGS):
            suspects = first.suspects()
            if not suspects.flags or suspects.may_be_causes:
                break
            tell("leaving out readings that were recorded otherwise than they were measured")
            first = first.without(suspects.flags)
        return first

    def without(self, flags: Sequence[Flag]) -> FirstFit:
        """The fit without more readings."""
        both = merged(self.session.observations, (*self.flags, *flags))
        return self.of(self.question, self.session, self.validation, self.most_readings, both)


def _split(session: Session, validation: Session | None, seed: int) -> tuple[Observations, Observations]:
    if validation is not None:
        return session.observations.calibration, validation.observations
    observations = with_validation(session.observations, policy.VALIDATION_SHARE, seed)
    return observations.calibration, observations.validation


def _that_hold_something(readings: Observations) -> Observations:
    """Readings of which at least one component was measured."""
    return readings.rows(readings.is_measured.any(dim=1))
