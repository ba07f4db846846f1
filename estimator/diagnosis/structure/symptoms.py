"""Symptoms of a residual, before any cause is named: its size, its structure along covariates, its physical signatures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.residual_tests import LackOfFit, Structure, lack_of_fit, structure
from estimator.diagnosis.structure.signatures import Signatures, leading, signatures, words

MOST_LISTED = 12


@dataclass(frozen=True)
class Symptoms:
    """Symptoms of the residual of one fit."""

    lack_of_fit: LackOfFit
    structure: tuple[Structure, ...]
    signatures: Signatures

    @classmethod
    def of(cls, fit: Fit, seed: int = 0) -> Symptoms:
        """Examine the residual of a fit.

        Args:
            fit: The fit.
            seed: Of the pure noise that the structure is compared with.
        """
        return cls(lack_of_fit(fit), tuple(structure(fit, seed)), signatures(fit))

    def to_json(self) -> dict[str, Any]:
        """These symptoms in the form of `diagnosis.json`."""
        return {
            "lack_of_fit": {
                "rms_T": self.lack_of_fit.rms_T,
                "noise_T": self.lack_of_fit.noise_T,
                "noise_from": self.lack_of_fit.noise_from,
                "p_value": self.lack_of_fit.p_value,
            },
            "structure": [
                {
                    "along": test.covariate.name,
                    "p_value": test.p_value,
                    "share": test.share,
                    "share_of_noise": test.expected_share,
                }
                for test in self.structure[:MOST_LISTED]
            ],
            "stays_with": self.signatures.stays_with,
            "current": self.signatures.current,
            "field_equations": self.signatures.field_equations,
        }

    def sentences(self) -> list[str]:
        """Sentences for a report, the size first."""
        size = self.lack_of_fit
        source = "repeats at the same pose" if size.noise_from == "repeats" else "the rig file"
        against = f"{size.rms_T * 1e6:.3g} µT rms a component; noise alone would give {size.noise_T * 1e6:.3g} µT ({source})"
        sentences = [f"The residual is {against}: {_against_noise(size)} (p = {_p(size.p_value)})."]
        striking = [test for test in self.structure if test.p_value < policy.SIGNIFICANT]
        if striking:
            names = "; ".join(f"{test.covariate.name} (p = {_p(test.p_value)})" for test in striking[:4])
            sentences.append(
                f"It has structure along {len(striking)} of {len(self.structure)} covariates: {names}."
            )
        else:
            sentences.append(f"It has no structure along any of {len(self.structure)} covariates.")
        for evidence in (
            self.signatures.stays_with,
            self.signatures.current,
            self.signatures.field_equations,
        ):
            answers = leading(evidence)
            if answers:
                sentences.append("It " + ", or ".join(words(answer) for answer in answers) + ".")
        return sentences


def _against_noise(size: LackOfFit) -> str:
    """Compare the residual with the noise in words.

    Examples:
        >>> _against_noise(LackOfFit(357e-6, 100e-6, "specification", 0.1))
        'more, but what is known of the noise does not rule that out'
    """
    if size.p_value < policy.SIGNIFICANT:
        return "more than noise explains"
    if size.rms_T > policy.CLEARLY_MORE * size.noise_T:
        return "more, but what is known of the noise does not rule that out"
    return "no more than noise explains"


def _p(value: float) -> str:
    return "below 0.0001" if value < 1e-4 else f"{value:.2g}"
