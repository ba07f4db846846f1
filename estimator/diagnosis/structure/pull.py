"""Whether the readings pull a number of the rig far from what its prior expects.

A wrong number in the rig file leaves no residual where the number is free: the fit moves it, against its prior. No curve shows that. A
prior that is right keeps its number within three or four of its widths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import log_mean_exp
from estimator.diagnosis.structure.doubt import Doubt
from estimator.rig.parameters import LogNormal, Normal

# Share of the knowledge of a number that the readings have; with less the first order does not hold: products of numbers bend it.
LEAST_KNOWN = 0.1


@dataclass(frozen=True)
class Pull(Doubt):
    """Evidence that the prior of a number of the rig is wrong: for a wider one, averaged over numbers and widths.

    Attributes:
        name: The number with the most evidence; empty where none has a prior with a width.
        widths: How far from the middle of its prior the readings alone would have it, in the prior's standard deviations.
    """

    name: str = ""
    widths: float = 0.0


def pull_of(fit: Fit) -> Pull:
    """The evidence that one of the numbers that a rig file states lies outside its prior; not of what was added, and not of the noise.

    A fit that the prior holds back would go farther without it. To first order, with `g = 1 - (sd / prior sd)^2` the share of its knowledge
    that the readings have of a number that lies `z` prior widths off, a prior `A` times as wide has a log Bayes factor of
    `z^2 / (2 (g + 1 / A^2)) - log(1 + g A^2) / 2`. Without a prior it would lie `z / g` widths off.
    """
    added = tuple(f"{cause.label}." for cause in fit.rig.acting)
    evidence, most = [], Pull(-math.inf)
    for parameter in fit.rig.free:
        prior, name = parameter.prior, parameter.name
        if not isinstance(prior, Normal | LogNormal) or name.startswith(added) or name.endswith(".noise_T"):
            continue
        value = float(fit.values[name])
        widths = prior.distance(value)
        width = value * prior.relative_sd if isinstance(prior, LogNormal) else prior.sd
        known = 1.0 - (fit.value_sd(name) / width) ** 2
        if known < LEAST_KNOWN:
            continue
        own = [_log_bayes_factor(widths, known, wider) for wider in policy.WIDER_PRIORS]
        evidence += own
        if max(own) > most.log_bayes_factor:
            most = Pull(max(own), name, widths / known)
    if not evidence:
        return Pull(0.0)
    return replace(most, log_bayes_factor=log_mean_exp(torch.tensor(evidence, dtype=torch.float64)))


def _log_bayes_factor(widths: float, known: float, wider: float) -> float:
    """Log Bayes factor of a wider prior for one number.

    The prior is `wider` times as wide, the number lies `widths` of its prior widths off, and readings have the share `known` of what is
    known of it.
    """
    return 0.5 * widths**2 / (known + wider**-2) - 0.5 * math.log1p(known * wider**2)
