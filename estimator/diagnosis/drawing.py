"""Numbers of a fit as a picture needs them: the outline of a winding, and vectors to the digits that a screen shows."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.panel_records import Vectors, WindingOutline
from estimator.model.bodies import round_winding_of
from estimator.rig.bodies import AnyCoil

DIGITS = 5


def outline_of(fit: Fit, coil: AnyCoil) -> WindingOutline | None:
    """A round coil's winding at a fit, in the coil's frame; None for any other coil."""
    winding = round_winding_of(fit.rig, coil, fit.values)
    if winding is None:
        return None
    inner_m = float(winding.radius_m - winding.thickness_m)
    return WindingOutline(inner_m, float(winding.radius_m), float(winding.length_m))


def rounded(vectors: Float[Tensor, "reading 3"]) -> Vectors:
    """Vectors to a few digits."""
    return [[float(f"{value:.{DIGITS}g}") for value in row] for row in vectors.tolist()]
