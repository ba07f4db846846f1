"""Symptoms of a residual, before any cause is named: its size, its structure along covariates, its physical signatures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.structure.residual_tests import LackOfFit, Structure, lack_of_fit, structure
from estimator.diagnosis.structure.signatures import Signatures, leading, signatures, words

CLEARLY_MORE = 1.2  # residual over noise from which on the report says more, though the noise may be so
SIGNIFICANT = 0.05  # p-value below which the report speaks of structure

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
            "lack_of_fit": asdict(self.lack_of_fit),
            "structure": [
                {
                    "along": test.covariate.name,
                    "p_value": test.p_value,
                    "share": test.share,
                    "share_of_noise": test.expected_share,
                }
                for test in self.structure[:MOST_LISTED]
            ],
            **asdict(self.signatures),
        }

    def sentences(self) -> list[str]:
        """Sentences for a report, the size first."""
        size = self.lack_of_fit
        source = "repeats at the same pose" if size.noise_from == "repeats" else "the rig file"
        against = f"{size.rms_T * 1e6:.3g} µT rms a component; noise alone would give {size.noise_T * 1e6:.3g} µT ({source})"
        sentences = [f"The residual is {against}: {_against_noise(size)} ({_p(size.p_value)})."]
        n, striking = len(self.structure), [t for t in self.structure if t.p_value < SIGNIFICANT]
        if striking:
            names = "; ".join(f"{test.covariate.name} ({_p(test.p_value)})" for test in striking[:4])
            sentences.append(f"It has structure along {len(striking)} of {n} covariates: {names}.")
        else:
            sentences.append(f"It has no structure along any of {n} covariates.")
        answers = map(leading, asdict(self.signatures).values())
        return sentences + [f"It {', or '.join(map(words, alike))}." for alike in answers if alike]


def _against_noise(size: LackOfFit) -> str:
    """Compare the residual with the noise in words.

    Examples:
        >>> _against_noise(LackOfFit(357e-6, 100e-6, "specification", 0.1))
        'more, but what is known of the noise does not rule that out'
    """
    if size.p_value < SIGNIFICANT:
        return "more than noise explains"
    if size.rms_T > CLEARLY_MORE * size.noise_T:
        return "more, but what is known of the noise does not rule that out"
    return "no more than noise explains"


def _p(value: float) -> str:
    """A p-value, or that it is below what matters.

    Examples:
        >>> _p(0.0312), _p(1e-9)
        ('p = 0.031', 'p < 0.0001')
    """
    return "p < 0.0001" if value < 1e-4 else f"p = {value:.2g}"
