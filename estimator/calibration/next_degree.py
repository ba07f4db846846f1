"""Whether readings ask for a finer field than a rig gives its coils without a winding: one degree more, or closer charges."""

from __future__ import annotations

from dataclasses import replace
from statistics import median

import torch

from estimator.inference.collapsed import CollapsedPosterior
from estimator.inference.likelihood import LogPosterior
from estimator.readings.observations import Observations
from estimator.rig.bodies import AnyCoil, EquivalentSourceCoil, HarmonicCoil
from estimator.rig.charged_box import MOST_CHARGES, n_charges
from estimator.rig.coordinates import Coordinates
from estimator.rig.harmonic_terms import HIGHEST_DEGREE
from estimator.rig.parameters import Normal, Parameter
from estimator.rig.rig import Rig

CLOSER = 0.8  # of margin and spacing of charges: about a quarter more of them
WIDTHS = (1.0, 0.1, 0.01)  # of what the priors say: too wide a prior hides a degree that is there but small
CLEAR_LOG_EVIDENCE = 3.0  # 20 to 1, as for causes: with less the degree may well do


def next_degree_gain(
    posterior: CollapsedPosterior, observations: Observations, vector: torch.Tensor
) -> float | None:
    """Rise in log evidence when every coil without a winding gets one degree more, or its charges closer to the box and to each other.

    Priors of the new degree narrow on as they did, or are ten or a hundred times narrower: the best of these counts. Intervals hold for
    fields of the degrees that a rig has. Where a higher degree has clear evidence they are too narrow, and the noise takes up what is
    missing. The other parameters keep their values, so the rise is rather too small.

    Args:
        posterior: Of the rig as it is.
        observations: The readings.
        vector: Most probable coordinates of the posterior.
    Returns: The rise; None where no coil can have a higher degree.
    """
    rises = []
    with torch.no_grad():
        before = float(posterior.log_likelihood(vector[None])[0])
        has_degrees = any(coil.has_degrees for coil in posterior.full.coordinates.rig.unwound)
        for share in WIDTHS if has_degrees else WIDTHS[:1]:
            rig = with_next_degree(posterior.full.coordinates.rig, share)
            if rig is None:
                return None
            rules = posterior.full.model.rules
            higher = CollapsedPosterior(LogPosterior.by_rules(Coordinates(rig), observations, rules))
            rises.append(float(higher.log_likelihood(vector[None])[0]) - before)
    return max(rises)


def with_next_degree(rig: Rig, share: float = 1.0) -> Rig | None:
    """The rig with one degree more, or closer charges, in every coil without a winding where these are free; None where there is none.

    Args:
        rig: As it is.
        share: Of the width that the priors of the new degree would have if they went on narrowing as before.
    """
    coils: list[AnyCoil] = []
    parameters = dict(rig.parameters)
    for coil in rig.coils:
        if isinstance(coil, EquivalentSourceCoil):
            coils.append(_with_closer_charges(coil, parameters))
            continue
        widths = _widths(coil, rig) if isinstance(coil, HarmonicCoil) else []
        if not isinstance(coil, HarmonicCoil) or not widths or coil.degree == HIGHEST_DEGREE:
            coils.append(coil)
            continue
        higher = replace(coil, degree=coil.degree + 1)
        sd = share * widths[-1] * min(1.0, widths[-1] / widths[-2] if len(widths) > 1 else 1.0)
        for name in higher.amplitudes[higher.degree]:
            parameters[name] = Parameter(name, "T/A", 0.0, Normal(0.0, sd))
        coils.append(higher)
    return None if tuple(coils) == rig.coils else replace(rig, coils=tuple(coils), parameters=parameters)


def _with_closer_charges(
    coil: EquivalentSourceCoil, parameters: dict[str, Parameter]
) -> EquivalentSourceCoil:
    """A coil with smaller margin and spacing, whose charges have the prior that all had before; without such a prior the coil itself."""
    closer = replace(coil, margin_m=CLOSER * coil.margin_m, spacing_m=CLOSER * coil.spacing_m)
    (names,) = coil.amplitudes.values()
    prior = parameters[names[0]].prior
    is_one = prior is not None and all(parameters[name].prior == prior for name in names)
    if not is_one or n_charges(closer.intervals) > MOST_CHARGES:
        return coil
    for name in names:
        del parameters[name]
    for name in closer.amplitudes[1]:
        parameters[name] = Parameter(name, "T/A", 0.0, prior)
    return closer


def _widths(coil: HarmonicCoil, rig: Rig) -> list[float]:
    """Typical width of the priors of each degree; none where the highest degree has none."""
    by_degree = [
        [prior.sd for name in names if (prior := rig.parameters[name].prior) is not None]
        for names in coil.amplitudes.values()
    ]
    return [median(own) for own in by_degree if own] if by_degree[-1] else []
