"""Flexible discrepancy for what no known cause explains: it detects structure and bounds it, but never extrapolates.

It is the evidence of a bank of curves (`structure.families`), averaged over all of them, so that a longer bank raises no more false alarms.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import (
    Products,
    log_bayes_factor_by_width,
    log_bayes_factor_of_noise,
    log_mean_exp,
)
from estimator.diagnosis.structure.families.collection import Family
from estimator.side_by_side import each

MOST_COLUMNS = 400  # in one batch: it should fit the processor's cache


@dataclass(frozen=True)
class Discrepancy:
    """Evidence for structure in a residual.

    Attributes:
        log_bayes_factor: Against no structure, averaged over families and amplitudes.
        family: Name of the family with the largest evidence.
        by_family: Log Bayes factor by name of family.
        rms_sigma: Rms of the most probable curve of that family, less what the fit can follow, in units of the noise.
        columns: Whitened columns of that family, with standard normal coefficients.
    """

    log_bayes_factor: float
    family: str
    by_family: dict[str, float]
    rms_sigma: float
    columns: Float[Tensor, "component column"]

    def weighed(self, weight: Float[Tensor, " component"]) -> Discrepancy:
        """The discrepancy with each component's weight multiplied; its rms in units of the noise stays."""
        amplitude = self.columns.square().sum(1).mean().sqrt()
        return replace(
            self, columns=amplitude * Family.of(self.family, self.columns * weight[:, None]).columns
        )


Batches = Sequence[tuple[list[int], Products]]  # numbers of families, and their products


def discrepancy(fit: Fit, families: Sequence[Family], batches: Batches | None = None) -> Discrepancy:
    """Evidence for structure in the residual of a fit, from some families of curves.

    Args:
        fit: Whose residual is asked.
        families: The curves.
        batches: Their products at the fit, where they are known.
    """
    evidence = evidence_by_amplitude(fit, families, batches=batches)
    by_family = by_name(families, evidence)
    total = log_mean_exp(torch.tensor(list(by_family.values()), dtype=torch.float64))
    top = int(evidence.max(1).values.argmax())
    strongest, amplitude = families[top], policy.AMPLITUDES[int(evidence[top].argmax())]
    curve = fit.projector.rest(_curve(fit, strongest.columns, amplitude))
    rms_sigma = float(curve.square().mean().sqrt())
    return Discrepancy(total, strongest.words, by_family, rms_sigma, amplitude * strongest.columns)


def by_name(families: Sequence[Family], evidence: Float[Tensor, "family amplitude"]) -> dict[str, float]:
    """Log Bayes factor averaged over the amplitudes of all families with the same name."""
    parts: dict[str, list[Tensor]] = {}
    for family, log_bayes_factors in zip(families, evidence, strict=True):
        parts.setdefault(family.name, []).append(log_bayes_factors)
    return {name: log_mean_exp(torch.cat(values)) for name, values in parts.items()}


def products_of(fit: Fit, families: Sequence[Family]) -> Batches:
    """Products of families at a fit. Families with equally many columns are taken together, some at a time."""
    by_width: dict[int, list[int]] = {}
    for i, family in enumerate(families):
        by_width.setdefault(family.columns.shape[1], []).append(i)
    batches = list[list[int]]()
    for width, members in by_width.items():
        n_together = max(1, MOST_COLUMNS // width)
        batches += [members[first : first + n_together] for first in range(0, len(members), n_together)]
    projector, residual = fit.projector, fit.residual

    def products(some: list[int]) -> tuple[list[int], Products]:
        return some, Products.of(torch.stack([families[i].columns.T for i in some]), projector, residual)

    return list(each(products, batches))


def evidence_by_amplitude(
    fit: Fit,
    families: Sequence[Family],
    amplitudes: Sequence[float] | None = None,
    batches: Batches | None = None,
) -> Float[Tensor, "family amplitude"]:
    """Log Bayes factor of each family against no structure, for each amplitude in units of the noise.

    Args:
        fit: Whose residual is asked.
        families: The curves.
        amplitudes: Rms of the curves; `policy.AMPLITUDES` by default.
        batches: Products of the families at the fit, where they are known.
    """
    rms = fit.residual.new_tensor(policy.AMPLITUDES if amplitudes is None else amplitudes)
    result = rms.new_zeros(len(families), len(rms))
    projector, noise = fit.projector, fit.free_noise

    def evidence(batch: tuple[list[int], Products]) -> Tensor:
        some, products = batch
        widths = rms.expand(len(some), -1)
        return log_bayes_factor_by_width(products.gram(projector), products.score, widths, noise)

    batches = products_of(fit, families) if batches is None else batches
    for (some, _), values in zip(batches, each(evidence, batches), strict=True):
        result[some] = values
    return result


def expected_of_noise(
    fit: Fit, families: Sequence[Family], amplitudes: Sequence[float], batches: Batches | None = None
) -> Float[Tensor, "family amplitude"]:
    """Log Bayes factor of each family and amplitude as it is expected where the residual is noise, less what the fit follows."""
    rms = fit.residual.new_tensor(amplitudes)
    result = rms.new_zeros(len(families), len(rms))
    for some, products in products_of(fit, families) if batches is None else batches:
        result[some] = log_bayes_factor_of_noise(products.gram(fit.projector), rms.expand(len(some), -1))
    return result


def _curve(fit: Fit, columns: Tensor, amplitude: float) -> Tensor:
    """The most probable combination of columns."""
    prior = columns.new_ones(columns.shape[1]).diag() / amplitude**2
    precision = fit.projector.gram(columns, columns) + prior
    curve: Tensor = columns @ torch.linalg.solve(precision, columns.T @ fit.residual)
    return curve
