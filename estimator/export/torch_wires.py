"""Straight wires and arcs with their gradients in tensors, for a graph that has no branch: loops with straight sides, and leads."""

from __future__ import annotations

from jaxtyping import Float

from estimator.export.plain_model import PlainCoil
from estimator.field.quadrature import arcs_of
from estimator.field.sided import SidedWinding
from estimator.field.straight import MU0_OVER_4PI
from estimator.rig.bodies import Point
from estimator.tensors import Tensor, torch

SMALLEST_RHO2_M2 = 1e-300
# Currents along the sides, from the one at negative y on.
CURRENTS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))
FieldAndSlopes = tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3 3"]]


def of_leads(
    points_m: Float[Tensor, "point 3"], leads: tuple[tuple[Point, Point], ...]
) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3 3"]]:
    """Field and gradient of one ampere in pieces of wire, in the frame of the coil.

    Args:
        points_m: Points beside the wires.
        leads: Ends of each piece; one without length has no field.
    """
    ends_m = torch.tensor(leads, dtype=points_m.dtype)
    ways_m = ends_m[:, 1] - ends_m[:, 0]
    lengths_m = ways_m.norm(dim=-1, keepdim=True)
    along = ways_m / torch.where(lengths_m > 0.0, lengths_m, 1.0)
    field, slopes = straight(points_m[:, None] - ends_m.mean(1), along, 0.5 * lengths_m)
    return MU0_OVER_4PI * field.sum(1), MU0_OVER_4PI * slopes.sum(1)


def straight(
    away_m: Float[Tensor, "*batch 3"], along: Float[Tensor, "*#batch 3"], half_m: Float[Tensor, "*#batch 1"]
) -> FieldAndSlopes:
    """4 pi B / mu0 of straight wires of one ampere, and its derivatives.

    Args:
        away_m: Points, from the middles of the wires.
        along: Directions of the current.
        half_m: Half the lengths.
    References: as `estimator.field.straight`.
    """
    u = (away_m * along).sum(-1, keepdim=True)
    beside = away_m - u * along
    rho2 = (beside * beside).sum(-1, keepdim=True)
    to_start, to_end = u + half_m, u - half_m
    a, b = torch.sqrt(to_start**2 + rho2), torch.sqrt(to_end**2 + rho2)
    product, inner = a * b, to_start * to_end + rho2
    is_beside = inner < 0.0
    apart = (2.0 * half_m) ** 2 * rho2 / torch.where(is_beside, product - inner, 1.0)
    w = 2.0 * half_m * (a + b) / (product * torch.where(is_beside, apart, product + inner))
    w_u, w_half = a**-3 - b**-3, a**-3 + b**-3
    is_off_line = rho2 > SMALLEST_RHO2_M2
    w_rho = torch.where(
        is_off_line, -(2.0 * w + u * w_u + half_m * w_half) / torch.where(is_off_line, rho2, 1.0), 0.0
    )
    along = along.expand_as(away_m)
    across = torch.linalg.cross(along, beside)
    return w * across, _turned(along, across, w, w_u * along + w_rho * beside)


def sided_per_ampere(
    coil: PlainCoil, winding: SidedWinding, points_m: Float[Tensor, "point 3"], rule: Tensor
) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3 3"]]:
    """Field and gradient per ampere of a winding with straight sides, in its frame.

    Args:
        coil, winding: The coil, and its winding.
        points_m: Points.
        rule: Number of the rule of each point.
    """
    height, half_x, half_y, radius, weight = _loops(coil, winding)[rule].unbind(-1)
    up = points_m[:, 2, None] - height
    x, y = (points_m[:, i, None].expand_as(up) for i in range(2))
    along = torch.tensor(CURRENTS, dtype=points_m.dtype)
    halves = torch.stack((half_x, half_y, half_x, half_y), dim=-1)
    outs = torch.stack((half_y, half_x, half_y, half_x), dim=-1)
    # Sides lie right of their current.
    away_x, away_y = x[..., None] - along[:, 1] * outs, y[..., None] + along[:, 0] * outs
    away = torch.stack((away_x, away_y, up[..., None].expand_as(outs)), dim=-1)
    field, slope = straight(away, along, (halves - radius[..., None])[..., None])
    fields, slopes = field.sum(-2), slope.sum(-3)
    if winding.is_rounded:
        arcs = padded([torch.from_numpy(arcs_of(each.steps)) for each in coil.rules], 2)
        field, slope = _arcs((x, y, up), (half_x - radius, half_y - radius, radius), arcs[rule])
        fields, slopes = fields + field, slopes + slope
    shares = MU0_OVER_4PI * weight[..., None]
    return (shares * fields).sum(1), (shares[..., None] * slopes).sum(1)


def _arcs(
    point_m: tuple[Tensor, Tensor, Tensor],
    shape_m: tuple[Tensor, Tensor, Tensor],
    arc: Float[Tensor, "point node 5"],
) -> FieldAndSlopes:
    """4 pi B / mu0 of the arcs of each loop, without a matrix for each of their many points."""
    x, y, up = (value[..., None] for value in point_m)
    middle_x, middle_y, radius = (value[..., None] for value in shape_m)
    cos, sin, share, right, back = (part[:, None] for part in arc.unbind(-1))
    away_x, away_y = x - right * middle_x - radius * cos, y - back * middle_y - radius * sin
    r2 = away_x**2 + away_y**2 + up**2
    near = radius * share * r2**-1.5
    fall, out = 3.0 * near / r2, sin * away_y + cos * away_x
    parts = [weight * part for weight in (near, fall) for part in (cos, sin, out)]
    parts += [fall * part * away for part in (cos, sin, out) for away in (away_x, away_y)]
    c, s, o, fc, fs, fo, cx, cy, sx, sy, ox, oy = (part.sum(-1) for part in parts)
    up = up[..., 0]
    field = torch.stack((up * c, up * s, -o), dim=-1)
    rows = (
        torch.stack((-up * cx, -up * cy, c - up**2 * fc), dim=-1),
        torch.stack((-up * sx, -up * sy, s - up**2 * fs), dim=-1),
        torch.stack((ox - c, oy - s, up * fo), dim=-1),
    )
    return field, torch.stack(rows, dim=-2)


def _turned(along: Tensor, across: Tensor, factor: Tensor, steeper: Tensor) -> Tensor:
    """Derivatives of a factor times (along x away): that of the product, and that of the factor, along `steeper`."""
    x, y, z = (factor * along).unbind(-1)
    none = torch.zeros_like(x)
    rows = (
        torch.stack((none, -z, y), dim=-1),
        torch.stack((z, none, -x), dim=-1),
        torch.stack((-y, x, none), dim=-1),
    )
    return across[..., :, None] * steeper[..., None, :] + torch.stack(rows, dim=-2)


def _loops(coil: PlainCoil, winding: SidedWinding) -> Float[Tensor, "rule loop 5"]:
    """Height, half sides, corner radius and weight of the loops of every rule; shorter rows end in loops that weigh nothing."""
    rows = []
    for rule in coil.rules:
        height = winding.axial_pitch_m * (rule.axial.nodes - 0.5 * winding.axial_loops)[:, None]
        out = winding.radial_pitch_m * (rule.radial.nodes + 0.5 * winding.radial_loops)
        radius = winding.corner_radius_m + out if winding.is_rounded else torch.zeros_like(out)
        weight = rule.axial.weights[:, None] * rule.radial.weights
        parts = (height, 0.5 * winding.side_x_m + out, 0.5 * winding.side_y_m + out, radius, weight)
        rows.append(torch.stack(torch.broadcast_tensors(*parts), dim=-1).flatten(0, 1))
    return padded(rows, 4)


def padded(rows: list[Tensor], weight: int) -> Float[Tensor, "rule loop number"]:
    """Rows of one length: the first loop, without its weight, follows the shorter ones.

    Args:
        rows: Numbers of the loops of each rule.
        weight: Which of the numbers is the weight.
    """
    longest, same_length = max(map(len, rows)), []
    for row in rows:
        weightless = row[:1].clone()
        weightless[:, weight] = 0.0
        same_length.append(torch.cat((row, weightless.expand(longest - len(row), -1))))
    return torch.stack(same_length)
