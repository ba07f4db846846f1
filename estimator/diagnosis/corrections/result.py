"""What corrects predictions without a name, and what stands in the way of a better correction."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.validation import Improvement
from estimator.effects import EFFECTS
from estimator.effects.corrections.correction import Correction as CorrectionEffect
from estimator.readings.cycles import CYCLE, cycle_of_currents_s, is_of_cycle
from estimator.readings.observations import SECONDS_PER_HOUR
from estimator.reporting.numbers import size_with_unit
from estimator.rig.rig import Cause

# Error of the predicted field over that without a correction, where the rig as described can follow half of what acts on readings alone.
INSTANT = re.compile(r"since\d+_h")
# Factor on a period, and its unit, by the key of the frequency.
PERIODS = {
    "frequency_per_h": (SECONDS_PER_HOUR, "s"),
    "frequency_per_m": (1e3, "mm"),
    "frequency_per_T": (1e3, "mT"),
}


@dataclass(frozen=True)
class Part:
    """One kind of correction at one place, as it was taken.

    Attributes:
        degree: Highest degree of its terms.
        n_amplitudes: Their number.
        log_bayes_factor: In the linear model, beside everything else, against none of this kind.
        probability: That something of this kind is there.
        extent: Instants of steps, the period of a swing, the size of what is whole, or the degree of anything else, in words.
        is_predicted: The field of a prediction has it; else it acts on the readings of this session.
    """

    cause: Cause
    degree: int
    n_amplitudes: int
    log_bayes_factor: float
    probability: float
    extent: str
    is_predicted: bool

    @property
    def is_whole(self) -> bool:
        """Whether its degrees are alike, so that it has a size and no highest degree."""
        effect = EFFECTS[self.cause.name]
        return isinstance(effect, CorrectionEffect) and effect.is_whole

    def to_json(self) -> dict[str, Any]:
        """An entry of `parts` in `diagnosis.json`."""
        return {
            "name": self.cause.name,
            "place": self.cause.place,
            "degree": self.degree,
            "amplitudes": self.n_amplitudes,
            "log_bayes_factor": self.log_bayes_factor,
            "probability": self.probability,
            "extent": self.extent,
        }


@dataclass(frozen=True)
class Correction:
    """What corrects predictions without a name.

    Attributes:
        fit: Of the readings of the search, with the corrections; as it was where none was taken.
        parts: The corrections, surest first; none where causes that are not sure enough to be stated correct by themselves.
        limits: By kind and place why no higher degree was asked, or none, and what to measure.
        refusal: Why nothing is corrected; empty where something is.
        final: The same, fitted to more readings.
        gain: On unseen readings, over the causes alone; None where there are none, or nothing was taken.
        of_session: What leads too and is not corrected: what a current did by time or by what was before, which no prediction has.
        is_cut_short: The time was over before all were asked.
    """

    fit: Fit
    parts: tuple[Part, ...]
    limits: dict[str, str]
    refusal: str
    final: Fit
    gain: Improvement | None = None
    of_session: tuple[Part, ...] = ()
    is_cut_short: bool = False

    @property
    def is_taken(self) -> bool:
        """Whether predictions are corrected."""
        return not self.refusal

    def words(self, label: Callable[[Cause], str]) -> str:
        """What is corrected, or why nothing is, and what is left looks like, with the names that the diagnosis gives."""
        if not self.is_taken:
            corrected = f"Nothing is corrected: {self.refusal}."
        else:
            of_field = told_together([part for part in self.parts if part.is_predicted], label)
            of_readings = told_together([part for part in self.parts if not part.is_predicted], label)
            by = of_field or ("" if of_readings else "causes that are not sure enough to be stated")
            corrected = " ".join(
                sentence
                for sentence, has_any in (
                    (f"Predictions are corrected, not explained, by {by}.", by),
                    (f"Fitted too, but no part of the field: {of_readings}.", of_readings),
                    ("Intervals stay widened by what was left.", True),
                )
                if has_any
            )
        if not self.of_session:
            return corrected
        looks = told_together(self.of_session, label)
        return f"What is left looks like {looks}; no prediction has that, so none is corrected by it. {corrected}"

    def judged_by(self, gain: Improvement, missed_T: tuple[float, float]) -> Correction:
        """The correction after its gain on unseen readings, which drop it where it predicts them worse.

        Args:
            gain: Over the causes alone.
            missed_T: By how much the predicted field misses these readings without and with it, beside what sensors do in every session.
        """
        is_farther = gain.after.errors.vector_T > gain.before.errors.vector_T
        is_worse = gain.is_loss or (is_farther and gain.elpd_difference <= 0.0)
        without, with_it = missed_T
        refusal = self.refusal
        if is_worse:
            refusal = "unseen readings are predicted worse with what was tried"
        elif with_it > policy.MOST_TAKEN * without:
            refusal = (
                "what follows these readings takes so much from the coil that the field alone would miss them by "
                f"{size_with_unit(with_it, 'T', 3)} instead of {size_with_unit(without, 'T', 3)}"
            )
        return replace(self, gain=gain, refusal=refusal)

    def to_json(self) -> dict[str, Any]:
        """Content of `correction` in `diagnosis.json`."""
        return {
            "parts": [part.to_json() for part in self.parts],
            "of_session": [part.to_json() for part in self.of_session],
            "limits": self.limits,
            "refusal": self.refusal,
            "gain": None
            if self.gain is None
            else {
                "with_causes": self.gain.before.to_json(),
                "with_correction": self.gain.after.to_json(),
                "elpd_difference": self.gain.elpd_difference,
                "elpd_se": self.gain.elpd_se,
            },
        }


def told_together(parts: Sequence[Part], label: Callable[[Cause], str]) -> str:
    """Names and extents, those of one kind at several places together."""
    alike: dict[tuple[str, str], list[Cause]] = {}
    for part in parts:
        alike.setdefault((part.cause.name, part.extent), []).append(part.cause)
    result = []
    for (name, extent), causes in alike.items():
        places = ", ".join(cause.place for cause in causes)
        result.append(f"{label(causes[0]) if len(causes) == 1 else f'{name}[{places}]'} {extent}")
    return "; ".join(result)


def extent_of(start: Mapping[str, float], degree: int, fit: Fit) -> str:
    """Instants of the steps of a correction, the period of its swing, or the degree of anything else.

    Args:
        start: What its terms are functions of.
        degree: Highest degree of its terms.
        fit: Of the same readings.
    """
    instants_h = [value for key, value in start.items() if INSTANT.fullmatch(key)]
    if instants_h:
        return f"at {', '.join(f'{SECONDS_PER_HOUR * at_h:.0f}' for at_h in sorted(instants_h))} s"
    for key, (factor, unit) in PERIODS.items():
        if start.get(key, 0.0) > 0.0:
            period = factor / start[key]
            cycle_s = cycle_of_currents_s(fit.observations) if unit == "s" else None
            session_s = SECONDS_PER_HOUR * fit.circumstances.duration_h
            is_cycle = is_of_cycle(period, cycle_s, session_s)
            return f"with a period of {period:.3g} {unit}{f' ({CYCLE})' if is_cycle else ''}"
    return f"to degree {degree}"
