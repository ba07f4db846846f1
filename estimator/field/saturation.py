"""How iron answers a field: a curve that saturates, solved with the field of the iron itself, and a memory of earlier currents."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

SUSCEPTIBILITY = 20.0  # at a strength of 0.5; about where the shape of a short rod begins to limit it
STEPS = 12  # of Newton's method
LEAST_LEFT = 0.02  # of the way to saturation, for steps that overshoot


def susceptibility(strength: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch"]:
    """Initial susceptibility of iron: 0 at a strength of 0, 20 at 0.5, 500 at 0.96, without limit at 1."""
    return SUSCEPTIBILITY * strength / (1.0 - strength)


def froehlich_T(
    field_T: Float[Tensor, "*#batch"],
    susceptibility: Float[Tensor, "*#batch"],
    saturation_T: Float[Tensor, "*#batch"],
) -> Float[Tensor, "*batch"]:
    """Polarisation of iron in the field mu0 H by the curve of Froehlich and Kennelly.

    References: Bozorth, Ferromagnetism (1951), chapter 11: `B = H / (a + b |H|)`.

    >>> field_T = torch.tensor([0.0, 0.02], dtype=torch.float64)
    >>> froehlich_T(field_T, torch.tensor(100.0), torch.tensor(2.0)).tolist()
    [0.0, 1.0]
    """
    return susceptibility * field_T / (1.0 + susceptibility * field_T.abs() / saturation_T)


def polarisation_T(
    applied_T: Float[Tensor, "*#batch pattern"],
    demagnetisation: Float[Tensor, "*#batch pattern pattern"],
    strength: Float[Tensor, "*#batch pattern"],
    saturation_T: Float[Tensor, "*#batch pattern"],
    sizes: Float[Tensor, "pattern pattern"],
) -> Float[Tensor, "*batch pattern"]:
    """Polarisation J of all patterns, each on Froehlich's curve in the field `applied - demagnetisation @ J`.

    Newton's method runs without derivatives; its last step carries exact first ones.

    Args:
        applied_T: mu0 H of what does not belong to the iron.
        demagnetisation: Field of the patterns on each other, against them.
        strength: Of the iron, `susceptibility`.
        saturation_T: Polarisation that it cannot exceed.
        sizes: Which patterns' fields are the size of the field for a pattern, as weights.
    """

    def rest(
        polarisation_T: Tensor, applied_T: Tensor, matrix: Tensor, strength: Tensor, saturation_T: Tensor
    ) -> tuple[Tensor, Tensor]:
        """What is left of the law, times the strength over the susceptibility, and the field inside."""
        inside_T = applied_T - (matrix @ polarisation_T[..., None])[..., 0]
        stiff = (1.0 - strength) / SUSCEPTIBILITY + strength * (inside_T.abs() @ sizes.mT) / saturation_T
        return stiff * polarisation_T - strength * inside_T, inside_T

    known = [value.detach() for value in (applied_T, demagnetisation, strength, saturation_T)]
    applied, matrix, s, limit_T = known
    stiff = torch.diag_embed((1.0 - s) / SUSCEPTIBILITY)
    now_T = _solved(stiff + s[..., None] * matrix, s * applied)
    now_T = limit_T * now_T / (limit_T + now_T.abs())  # towards the curve, from below

    def slope(inside_T: Tensor, now_T: Tensor) -> Tensor:
        size_T = inside_T.abs() @ sizes.mT
        own = torch.diag_embed((1.0 - s) / SUSCEPTIBILITY + s * size_T / limit_T)
        bend = (s * now_T / limit_T)[..., None] * (sizes * torch.sign(inside_T)[..., None, :])
        return own + (s[..., None] * torch.eye(len(sizes), dtype=s.dtype) - bend) @ matrix

    for _ in range(STEPS):
        left, inside_T = rest(now_T, *known)
        step_T = _solved(slope(inside_T, now_T), left)
        room_T = LEAST_LEFT * limit_T + (limit_T - now_T.abs()).clamp(min=0.0)
        now_T = now_T - step_T.clamp(-room_T, room_T)
    left, inside_T = rest(now_T, *known)
    exact, _ = rest(now_T, applied_T, demagnetisation, strength, saturation_T)
    return now_T - _solved(slope(inside_T, now_T), exact)


def played(drive: Float[Tensor, " history"], width: Float[Tensor, "*batch"]) -> Float[Tensor, "*batch history"]:
    """What a play (backlash) of half a width follows of a drive, which comes from 0: it moves only once the drive pushes it.

    Each step holds what came before between `drive - width` and `drive + width`. Two such steps after each other are one, so that all
    prefixes follow by doubling.

    References: Visintin, Differential Models of Hysteresis (1994), section III.2.

    >>> played(torch.tensor([1.0, 3.0, 2.5, 0.0]), torch.tensor(0.5)).tolist()
    [0.5, 2.5, 2.5, 0.5]
    """
    low, high = drive - width[..., None], drive + width[..., None]
    reach = 1
    while reach < drive.shape[-1]:
        before_low, before_high = low[..., :-reach], high[..., :-reach]
        now_low, now_high = low[..., reach:], high[..., reach:]
        low = torch.cat((low[..., :reach], _between(before_low, now_low, now_high)), dim=-1)
        high = torch.cat((high[..., :reach], _between(before_high, now_low, now_high)), dim=-1)
        reach *= 2
    return _between(torch.zeros_like(low), low, high)


def _solved(matrix: Tensor, vector: Tensor) -> Tensor:
    solution: Tensor = torch.linalg.solve(matrix, vector[..., None])[..., 0]
    return solution


def _between(value: Tensor, low: Tensor, high: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(value, low), high)
