"""Design of the next readings: to tell causes apart, to shrink the interval of a parameter, or to map a field for a correction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from estimator.diagnosis import effort, policy
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import candidates
from estimator.diagnosis.next_readings.expected_evidence import (
    Proposal,
    actions,
    proposals,
)
from estimator.diagnosis.next_readings.map_places import map_stops, with_correction
from estimator.diagnosis.next_readings.resolution import PLAUSIBLE_SD, TYPICAL_SIGMA
from estimator.diagnosis.next_readings.stops import best_to_shrink, best_to_split, candidate_stops
from estimator.diagnosis.progress import OnCount, uncounted
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.everywhere import with_everywhere
from estimator.errors import InvalidInput, closest
from estimator.model.hide import cause_of
from estimator.model.measurement_model import MeasurementModel
from estimator.model.preflight import check_readings
from estimator.readings.observations import Observations
from estimator.readings.plan import plan_text
from estimator.reporting.numbers import quantity_words, size_with_unit
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session

# Visible size of a cause as large as its prior's width, in standard deviations, below which a design refuses it
NEARLY_NOTHING = 0.1

FITTING = "fitting the rig, then each cause"


@dataclass(frozen=True)
class Design:
    """Proposed next readings.

    Attributes:
        goal: In words.
        unit: Of the value that is to be reached; empty for a log evidence.
        actions: Whole programmes with their expected log evidence, best first; empty where causes are not to be told apart.
        readings: Chosen stops, in order.
        so_far: Value that the session has reached: expected log evidence; standard deviation of the parameter; or rms of those of a
            correction's amplitudes; in SI.
        reached: The same value after each of the stops, by the same formula.
        plan: The stops as a plan file.
    """

    goal: str
    unit: str
    actions: tuple[Proposal, ...]
    readings: Observations
    so_far: float
    reached: tuple[float, ...]
    plan: str

    def to_json(self) -> dict[str, Any]:
        """All but the readings, as JSON; `plan` is the text of the plan."""
        programmes = [
            {"action": programme.action.words, "expected_log_evidence": programme.expected_log_evidence}
            for programme in self.actions
        ]
        return {
            "goal": self.goal,
            "unit": self.unit,
            "programmes": programmes,
            "so_far": self.so_far,
            "reached": list(self.reached),
            "plan": self.plan,
        }


def design(
    session: Session,
    *,
    split: Sequence[str] = (),
    shrink: str | None = None,
    correction: str | None = None,
    degree: int = 3,
    n_readings: int = 20,
    rig: Rig | None = None,
    on_count: OnCount = uncounted,
) -> Design:
    """Propose the next readings.

    Args:
        session: Readings so far.
        split: Two or more causes, as `cause` or `cause[place]`, to be told apart. Each has its fitted size where the session shows it,
            else one of eight standard deviations, or of three of its prior where these are less; the goal in words says so.
        shrink: A parameter of the rig whose interval is to shrink.
        correction: A correction, as `coil_harmonics[coil1]`, whose amplitudes are to be determined by a map.
        degree: Highest degree of its terms.
        n_readings: How many stops to choose.
        rig: Another description of the session's rig.
        on_count: Called as fits, programmes and stops are done.
    Raises:
        InvalidInput: Not one goal is given, or it names something that the rig does not have.
    """
    if [bool(split), shrink is not None, correction is not None].count(True) != 1 or len(split) == 1:
        raise InvalidInput(
            "a design must split two or more causes, or shrink one parameter, or map one correction; "
            f"received split {list(split)}, shrink {shrink!r}, map {correction!r}"
        )
    rig = rig or session.rig
    session.check_rig(rig)
    check_readings(rig, session.observations, session.source)
    observations = session.observations.calibration
    causes = [cause_of(text, rig) for text in split]
    everywhere = with_everywhere(rig, observations)
    if not {*causes} & {*everywhere.added}:  # noise is to be that of a calibration
        rig = everywhere.rig
    on_count(FITTING, 0, 1 + len(split))
    base = fit_rig(rig, observations, {}, MeasurementModel.build(rig, observations).rules, effort.MORE_STARTS)
    programmes: list[Proposal] = []
    unit = ""
    if correction is not None:
        stops = map_stops(observations, rig)
        corrected, amplitudes = with_correction(base, correction, degree)
        rows, values = best_to_shrink(corrected, amplitudes, stops, n_readings, on_count)
        goal, unit = f"map {correction} to degree {degree}", corrected.rig.parameters[amplitudes[0]].unit
    elif shrink is not None:
        if shrink not in rig.parameters or base.value_sd(shrink) == 0.0:
            hint = closest(shrink, [parameter.name for parameter in rig.free])
            raise InvalidInput(
                f"shrink must name a parameter that the fit may change; received {shrink!r}{hint}"
            )
        stops = candidate_stops(observations)
        rows, values = best_to_shrink(base, [shrink], stops, n_readings, on_count)
        goal, unit = f"shrink {shrink}", rig.parameters[shrink].unit
    else:
        hypotheses: dict[str, Fit] = {}
        supposed: list[str] = []
        for cause in causes:
            on_count(FITTING, 1 + len(hypotheses), 1 + len(causes))
            hypotheses[cause.label], size = _fit_with(base, cause)
            supposed += [f"{cause.label} {size}"] if size else []
        stops = candidate_stops(observations)
        rows, values = best_to_split(hypotheses, stops, n_readings, on_count)
        programmes = proposals(hypotheses, actions(observations, rig), on_count)
        goal = f"tell {' from '.join(hypotheses)}"
        if supposed:
            goal += f", supposing {' or '.join(supposed)}, which the readings do not show"
    readings = stops.rows(rows)
    text = plan_text(goal, rig, readings, observations.pace_s)
    so_far, *reached = values.tolist()
    return Design(goal, unit, tuple(programmes), readings, so_far, tuple(reached), text)


def _fit_with(base: Fit, cause: Cause) -> tuple[Fit, str]:
    """The fit with a cause; where the readings hardly show it, with a size that they would show, which is told in words."""
    if cause in base.rig.effects:
        raise InvalidInput(f"{cause.label} must not be in the rig already to be told from another")
    pool = candidates(base, [cause])
    if not pool:
        raise InvalidInput(f"{cause.label} must have some effect on the readings of the session")
    best = max(pool, key=lambda candidate: float(base.projector.rest(candidate.columns).norm()))
    rig = with_effect(base.rig, cause, base.observations, best.shapes)
    fit = fit_rig(rig, base.observations, base.start_with(rig), base.posterior.model.rules)
    if fit.log_evidence - base.log_evidence > policy.CLEAR_LOG_EVIDENCE:
        return fit, ""
    visible = base.projector.rest(best.columns).norm(dim=0) * best.prior_sd
    strongest = int(visible.argmax())
    if float(visible[strongest]) < NEARLY_NOTHING:
        raise InvalidInput(
            f"{cause.label} must be visible in the session to be told from another; the fit follows it wholly"
        )
    size = min(TYPICAL_SIGMA / float(visible[strongest]), PLAUSIBLE_SD) * float(best.prior_sd[strongest])
    key = best.keys[strongest]
    null = {q.key: q.null for q in EFFECTS[cause.name].quantities(base.circumstances.extent)}[key]
    start = {**base.start_with(rig), f"{cause.label}.{key}": null + size}
    supposed = f"{quantity_words(key)} of {size_with_unit(size, best.units[strongest])}"
    return Fit(fit.posterior, fit.optimum.at(fit.posterior.coordinates.vector(start))), supposed
