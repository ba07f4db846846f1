"""What corrects predictions without a name, and what stands in the way of a better correction."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.cross_validation import HeldOut
from estimator.diagnosis.validation import Improvement
from estimator.readings.observations import SECONDS_PER_HOUR
from estimator.rig.rig import Cause

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
        log_bayes_factor: In the linear model, against none of this kind; of a full fit where it has a frequency.
        held_out: Gain in predicting blocks of places from the others.
    """

    cause: Cause
    degree: int
    n_amplitudes: int
    log_bayes_factor: float
    held_out: HeldOut


@dataclass(frozen=True)
class Correction:
    """What corrects predictions without a name.

    Attributes:
        fit: Of the readings of the search, with the corrections; as it was where none was taken.
        parts: The corrections, as they were taken; none where causes that stand in for something unknown correct by themselves.
        limits: By kind and place why no higher degree was asked, or none, and what to measure.
        refusal: Why nothing is corrected; empty where something is.
        final: The same, fitted to more readings.
        gain: On unseen readings, over the causes alone; None where there are none, or nothing was taken.
    """

    fit: Fit
    parts: tuple[Part, ...]
    limits: dict[str, str]
    refusal: str
    final: Fit
    gain: Improvement | None = None

    @property
    def is_taken(self) -> bool:
        """Whether predictions are corrected."""
        return not self.refusal

    def words(self, label: Callable[[Cause], str]) -> str:
        """What is corrected, or why nothing is, in one sentence with the names that the diagnosis gives."""
        if not self.is_taken:
            return f"Nothing is corrected: {self.refusal}."
        each = [f"{label(part.cause)} {self._extent(part)}" for part in self.parts]
        by = "; ".join(each) or "the causes that stand in"
        return f"Predictions are corrected, not explained, by {by}; intervals stay widened by what was left."

    def _extent(self, part: Part) -> str:
        """Instants of steps, the period of a swing, or the degree of anything else."""
        own = f"{part.cause.label}."
        values = {k.removeprefix(own): float(v) for k, v in self.fit.values.items() if k.startswith(own)}
        instants_h = [values[key] for key in values if INSTANT.fullmatch(key)]
        if instants_h:
            return f"at {', '.join(f'{SECONDS_PER_HOUR * at_h:.0f}' for at_h in sorted(instants_h))} s"
        for key, (factor, unit) in PERIODS.items():
            if values.get(key, 0.0) > 0.0:
                return f"with a period of {factor / values[key]:.3g} {unit}"
        return f"to degree {part.degree}"

    def judged_by(self, gain: Improvement) -> Correction:
        """The correction after its gain on unseen readings, which drop it where it predicts them worse."""
        is_worse = gain.is_loss or gain.after.errors.vector_T > gain.before.errors.vector_T
        words = "unseen readings are predicted worse with what was tried"
        return replace(self, gain=gain, refusal=words if is_worse else self.refusal)

    def to_json(self) -> dict[str, Any]:
        """Content of `correction` in `diagnosis.json`."""
        return {
            "parts": [
                {
                    "name": part.cause.name,
                    "place": part.cause.place,
                    "degree": part.degree,
                    "amplitudes": part.n_amplitudes,
                    "log_bayes_factor": part.log_bayes_factor,
                    "held_out": part.held_out.to_json(),
                }
                for part in self.parts
            ],
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
