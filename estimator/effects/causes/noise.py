"""Scatter of readings beyond equal normal noise. Predictions stay the same; the likelihood changes."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from estimator.effects.base import Kind, Quantity, Theta
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import (
    FEWEST_COMPONENTS,
    Deviations,
    Errors,
    NoiseEffect,
    NoiseEstimate,
    Prediction,
)
from estimator.rig.parameters import LogNormal, Uniform
from estimator.tensors import Tensor, torch

LOOSE_NOISE = 0.2  # relative width of a prior from which on the noise follows the readings by itself
EM_STEPS = 60
MOST_SHARE = 0.1  # of readings that an instrument spoils, as `source` has it
FIRST_RATIOS = (4.0, 10.0, 25.0)  # widths of outliers that the estimate starts from, in units of the noise


def _is_stated(circumstances: Circumstances, place: str) -> bool:
    """Whether the noise is fixed, or known tightly."""
    prior = circumstances.rig.parameters[f"{place}.noise_T"].prior
    return prior is None or prior.sd < LOOSE_NOISE * prior.centre


def _rms(whitened: Float[Tensor, " component"]) -> NoiseEstimate | None:
    """Noise over the stated one, by the rms of the whitened residual."""
    if len(whitened) <= FEWEST_COMPONENTS:
        return None
    mean_square = float(whitened.square().mean())
    gain = 0.5 * len(whitened) * (mean_square - 1.0 - math.log(mean_square))
    return NoiseEstimate({"factor": math.sqrt(mean_square)}, 1.0, gain)


@NoiseEffect.cause(
    "sigma_T",
    quantities=(Quantity("factor", "1", LogNormal(1.0, 0.7), 1.0),),
    concerns=_is_stated,
    estimate=_rms,
    disturbed_T=lambda error_T, theta: error_T * theta["factor"],
)
def noise_misstated(sigma_T: Deviations, theta: Theta) -> Deviations:
    """The readings scatter more, or less, than the noise that is stated.

    A sensor's readings scatter by a multiple of what the rig file says.

    Source: data sheets give the noise of another bandwidth: a factor of two either way.
    """
    return sigma_T * theta["factor"][..., None]


def _share_and_ratio(whitened: Float[Tensor, " component"]) -> NoiseEstimate | None:
    """Share and width by expectation and maximisation, from several widths."""
    if len(whitened) <= FEWEST_COMPONENTS:
        return None
    mixtures = [_mixture(whitened, ratio) for ratio in FIRST_RATIOS]
    share, wide, narrow, gain = max(mixtures, key=lambda mixture: mixture[3])
    return NoiseEstimate({"share": share, "ratio": wide / narrow}, narrow, gain)


def _mixture(z: Tensor, ratio: float) -> tuple[float, float, float, float]:
    """Share, wide and narrow scatter of a mixture of two normals about zero, and its improvement of the log likelihood over one."""
    share, narrow, wide = 0.05, 0.8 * float(z.square().mean().sqrt()), ratio
    log_likelihood = 0.0
    for _ in range(EM_STEPS):
        good = math.log1p(-share) - 0.5 * (z / narrow) ** 2 - math.log(narrow)
        bad = math.log(share) - 0.5 * (z / wide) ** 2 - math.log(wide)
        mixed = torch.logaddexp(good, bad)
        log_likelihood = float(mixed.sum())
        is_bad = torch.exp(bad - mixed)
        share = min(max(float(is_bad.mean()), 1e-4), 0.4)
        narrow = max(float(((1.0 - is_bad) * z**2).sum() / (1.0 - is_bad).sum()) ** 0.5, 1e-3)
        wide = max(float((is_bad * z**2).sum() / is_bad.sum().clamp(min=1e-9)) ** 0.5, 2.0 * narrow)
    rms = float(z.square().mean().sqrt())
    one_normal = -0.5 * len(z) - len(z) * math.log(rms)
    return share, wide, narrow, log_likelihood - one_normal


def _some_wild(error_T: Errors, theta: Theta, rng: np.random.Generator) -> Errors:
    """Errors of which a share grows."""
    is_wild = torch.from_numpy(rng.random(size=tuple(error_T.shape))).to(error_T) < theta["share"]
    return torch.where(is_wild, theta["ratio"] * error_T, error_T)


# Quantities: share of wrong components and their scatter in units of the noise.
@NoiseEffect.cause(
    "contamination",
    quantities=(
        Quantity("share", "1", Uniform(0.0, 0.5), 0.0, is_fixed=True),
        Quantity("ratio", "1", Uniform(1.0, 1e4), 1.0, is_shape=True, is_fixed=True),
    ),
    starts=({"ratio": 10.0},),
    # A larger share says that the model is wrong.
    is_itself=lambda theta: float(theta["share"]) <= MOST_SHARE,
    estimate=_share_and_ratio,
    disturbed_T=_some_wild,
)
def outliers(theta: Theta) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]]:
    """A share of the readings is wrong.

    A share of the readings is wrong: a contaminated normal distribution with a wide second component.

    Source: dropped bits, late triggers: some per mille to 10 %.
    """
    return theta["share"], theta["ratio"]


# Quantities: of the component that is read.
@NoiseEffect.cause(
    "sigma_T",
    quantities=(Quantity("share", "1", LogNormal(3e-3, 1.0), 0.0),),
    exposure=lambda prediction: prediction.field_sensor_T.abs(),
)
def noise_grows(sigma_T: Deviations, exposure: Float[Tensor, " component"], theta: Theta) -> Deviations:
    """The readings scatter the more, the larger they are.

    The sensor scatters by a share of what each axis shows, beside its noise: too few digits, an unsteady supply or amplifier.

    Source: two or three digits of a display, ripple of a supply: 0.05 to 3 % of the reading.
    """
    return torch.sqrt(sigma_T**2 + (theta["share"][..., None] * exposure) ** 2)


def _moved(
    error_T: Errors, prediction: Prediction, theta: Theta, place: str, rng: np.random.Generator
) -> Errors:
    """Errors with one displacement per reading, which moves its three components together."""
    off_m = torch.from_numpy(rng.normal(size=tuple(error_T.shape))).to(error_T) * theta["sd_m"]
    return error_T + torch.einsum("rij,rj->ri", prediction.gradient_T_per_m(place), off_m)


# Quantities: along each axis.
@NoiseEffect.cause(
    "sigma_T",
    quantities=(Quantity("sd_m", "m", LogNormal(50e-6, 1.0), 0.0),),
    kind=Kind.MOVER,
    exposure=lambda prediction, place: prediction.gradient_T_per_m(place).norm(dim=-1),
    directions_T=lambda prediction, theta, place: prediction.gradient_T_per_m(place) * theta["sd_m"],
    disturbed_T=_moved,
)
def position_jitter(sigma_T: Deviations, exposure: Float[Tensor, " component"], theta: Theta) -> Deviations:
    """The mover scatters about its targets.

    The mover scatters about its target; the field's gradient turns that into scatter of the reading.

    Source: repeatability of small arms, 10 to 100 um.
    """
    return torch.sqrt(sigma_T**2 + (theta["sd_m"][..., None] * exposure) ** 2)
