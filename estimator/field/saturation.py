"""How iron answers a field: a curve that saturates, solved with the field of the iron itself, and a memory of earlier currents."""

from __future__ import annotations

from jaxtyping import Float

from estimator.tensors import Tensor, torch

SUSCEPTIBILITY = 20.0  # at a strength of 0.5, about where the shape of a short rod begins to limit it
MOST_STEPS = 20  # of Newton's method, which takes 3 to 6
SETTLED_T = 1e-12
LEAST_LEFT = 0.02  # of the way to saturation, for steps that overshoot


def polarisation_T(
    applied_T: Float[Tensor, "*#batch pattern"],
    demagnetisation: Float[Tensor, "*#batch pattern pattern"],
    strength: Float[Tensor, "*#batch pattern"],
    limit_per_T: Float[Tensor, "*#batch pattern"],
) -> Float[Tensor, "*batch pattern"]:
    """Polarisation J of all patterns, each on the curve of Froehlich and Kennelly in the field `applied - demagnetisation @ J`.

    Newton's method runs without derivatives; its last step carries exact first ones.

    Args:
        applied_T: mu0 H of what does not belong to the iron.
        demagnetisation: Field of the patterns on each other, against them.
        strength: Of the iron: s / (1 - s) times `SUSCEPTIBILITY` is its initial susceptibility.
        limit_per_T: One over the polarisation that it cannot exceed; 0 where it does not saturate.
    """
    known = [value.detach() for value in (applied_T, demagnetisation, strength, limit_per_T)]
    applied, matrix, s, limit = known
    soft = torch.diag_embed((1.0 - s) / SUSCEPTIBILITY)
    now_T = _solved(soft + s[..., None] * matrix, s * applied)
    now_T = now_T / (1.0 + limit * now_T.abs())  # towards the curve, from below

    def slope(inside_T: Tensor, now_T: Tensor) -> Tensor:
        own = torch.diag_embed((1.0 - s) / SUSCEPTIBILITY + s * limit * inside_T.abs())
        return own + (s * (1.0 - limit * now_T * torch.sign(inside_T)))[..., None] * matrix

    for _ in range(MOST_STEPS):
        left_T, inside_T = _left_T(now_T, *known)
        step_T = _solved(slope(inside_T, now_T), left_T)
        room = LEAST_LEFT + (1.0 - limit * now_T.abs()).clamp(min=0.0)  # of the saturated polarisation
        too_far = (limit * step_T.abs() / room).clamp(min=1.0)
        now_T = now_T - step_T / too_far
        if bool((step_T.abs() < SETTLED_T).all()):
            break
    _, inside_T = _left_T(now_T, *known)
    exact_T, _ = _left_T(now_T, applied_T, demagnetisation, strength, limit_per_T)
    inverse = torch.linalg.inv(slope(inside_T, now_T))  # so that derivatives cost products, not solutions
    last_T: Tensor = (inverse @ exact_T[..., None])[..., 0]
    return now_T - last_T


def _left_T(
    now_T: Tensor, applied_T: Tensor, matrix: Tensor, strength: Tensor, limit_per_T: Tensor
) -> tuple[Tensor, Tensor]:
    """How far a polarisation is off the curve, multiplied by what stays finite without iron, and the field inside."""
    inside_T = applied_T - (matrix @ now_T[..., None])[..., 0]
    stiffness = (1.0 - strength) / SUSCEPTIBILITY + strength * limit_per_T * inside_T.abs()
    return stiffness * now_T - strength * inside_T, inside_T


def played(
    drive: Float[Tensor, " history"], width: Float[Tensor, "*batch"]
) -> Float[Tensor, "*batch history"]:
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
    """Solutions; no number where a matrix is singular, as far from any real core, so that a fit goes elsewhere."""
    solution, fault = torch.linalg.solve_ex(matrix, vector[..., None])
    return torch.where((fault == 0)[..., None], solution[..., 0], torch.nan)


def _between(value: Tensor, low: Tensor, high: Tensor) -> Tensor:
    return torch.minimum(torch.maximum(value, low), high)
