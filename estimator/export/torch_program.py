"""A program of `torch.export`: field and gradient of a calibrated magnet in a graph that PyTorch runs and differentiates by itself."""

from __future__ import annotations

import io

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn

from estimator.export.magnet import Magnet
from estimator.export.plain_model import PlainCoil, PlainModel, PlainMover
from estimator.export.request import Request
from estimator.export.torch_wires import of_leads, padded, sided_per_ampere
from estimator.field.loop import loop_derivatives
from estimator.field.node_sum import field_and_slopes_by_torch
from estimator.field.sided import SidedWinding, distance_to_sided
from estimator.field.winding import Winding, distance_to_winding
from estimator.field.zones import ZONES_PER_OCTAVE
from estimator.frames import Transform
from estimator.geometry.kinematics import base_from_flange

TRACED_POINTS = 4  # any number but 0 and 1 leaves the number of points open
DESCRIPTION = "description.txt"  # in the file, beside the graph


def program_file(request: Request) -> bytes:
    """The program as a file: `program.module()(points_m, currents_A, motion)` gives field_T and gradient_T_per_m.

    Raises:
        InvalidInput: A rig has something that the program cannot express.
    """
    magnet = request.magnet
    model = magnet.model("torch")
    arguments = (
        torch.zeros(TRACED_POINTS, 3, dtype=torch.float64),
        torch.zeros(len(model.coils), dtype=torch.float64),
        torch.zeros(len(model.movers), 6, dtype=torch.float64),
    )
    shapes = ({0: torch.export.Dim("point")}, None, None)
    with torch.no_grad():
        program = torch.export.export(MagnetProgram(model), arguments, dynamic_shapes=shapes)
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)  # paths of this computer
    content = io.BytesIO()
    torch.export.save(program, content, extra_files={DESCRIPTION: _description(magnet, model)})
    return content.getvalue()


def _description(magnet: Magnet, model: PlainModel) -> str:
    movers = "; ".join(f"{mover.name}: {', '.join(mover.columns)}" for mover in model.movers) or "none"
    lines = [
        f"Calibrated magnet {model.name!r}. SI units, world frame of the rig file, double precision.",
        "Arguments: points_m (n, 3); currents_A, commanded, of "
        + ", ".join(coil.name for coil in model.coils)
        + f"; motion, a row of six for each mover that carries a coil: {movers}.",
        "Results: field_T (n, 3), gradient_T_per_m (n, 3, 3) with dB_i / dx_j; NaN inside a winding.",
        *magnet.regions,
        magnet.origin,
    ]
    return "\n".join(lines) + "\n"


class MagnetProgram(nn.Module):
    """A plain model as a module whose graph has no branch and no coilcal in it."""

    delivered_A_per_A: Tensor
    offset_A: Tensor
    background_T: Tensor

    def __init__(self, model: PlainModel) -> None:
        super().__init__()
        self.model = model
        self.register_buffer("delivered_A_per_A", model.delivered_A_per_A)
        self.register_buffer("offset_A", model.offset_A)
        self.register_buffer("background_T", model.background_T)

    def forward(
        self,
        points_m: Float[Tensor, "point 3"],
        currents_A: Float[Tensor, " coil"],
        motion: Float[Tensor, "mover 6"],
    ) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3 3"]]:
        """Field in tesla and gradient dB_i / dx_j in T/m.

        Args:
            points_m: Points in the world frame.
            currents_A: Commanded current of each coil.
            motion: Six numbers of each mover that carries a coil.
        """
        delivered_A = self.delivered_A_per_A @ currents_A + self.offset_A
        field_T = self.background_T.expand_as(points_m)
        gradient = torch.zeros_like(points_m)[..., None].expand(-1, 3, 3)
        # Rows one by one: unbinding none of them makes a file that torch 2.13 cannot read.
        poses = [_pose(mover, motion[number]) for number, mover in enumerate(self.model.movers)]
        for coil, current_A in zip(self.model.coils, delivered_A.unbind(0), strict=True):
            flange = coil.world_from_base @ poses[coil.mover] if coil.mover >= 0 else coil.world_from_base
            world_from_coil = flange @ coil.flange_from_coil
            field, slopes = _per_ampere(coil, world_from_coil.inverse().apply(points_m))
            rotation = world_from_coil.rotation
            field_T = field_T + current_A * (field @ rotation.mT)
            gradient = gradient + current_A * (rotation @ slopes @ rotation.mT)
        return field_T, gradient


def _pose(mover: PlainMover, row: Float[Tensor, " 6"]) -> Transform:
    if mover.joints is None:
        return Transform.from_pose(row[:3], row[3:])
    return base_from_flange(mover.joints, row)


def _per_ampere(
    coil: PlainCoil, points_m: Float[Tensor, "point 3"]
) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3 3"]]:
    """Field and gradient per ampere in the frame of the coil, each point with the rule of its distance."""
    winding = coil.winding
    if isinstance(winding, SidedWinding):
        distance_m = distance_to_sided(points_m, winding)
        field, slopes = sided_per_ampere(coil, winding, points_m, _rule_numbers(coil, distance_m))
    else:
        distance_m = distance_to_winding(points_m, winding)
        field, slopes = _round_per_ampere(coil, winding, points_m, _rule_numbers(coil, distance_m))
    if coil.leads:
        of_wires = of_leads(points_m, coil.leads)
        field, slopes = field + of_wires[0], slopes + of_wires[1]
    is_outside = distance_m > 0.0
    return (
        torch.where(is_outside[:, None], field, torch.nan),
        torch.where(is_outside[:, None, None], slopes, torch.nan),
    )


def _rule_numbers(coil: PlainCoil, distance_m: Float[Tensor, " point"]) -> Int[Tensor, " point"]:
    level = torch.floor(ZONES_PER_OCTAVE * torch.log2(distance_m.clamp(min=1e-12))).to(torch.int64)
    level = (level - coil.first_level).clamp(0, len(coil.rule_of_level) - 1)
    return torch.tensor(coil.rule_of_level)[level]


def _round_per_ampere(
    coil: PlainCoil, winding: Winding, points_m: Float[Tensor, "point 3"], rule: Int[Tensor, " point"]
) -> tuple[Float[Tensor, "point 3"], Float[Tensor, "point 3 3"]]:
    x, y, z = points_m.unbind(-1)
    heights_m, radii_m, weights = (table[rule] for table in _loops(coil, winding))
    steps = max(rule.steps for rule in coil.rules)  # more steps than a rule needs change nothing
    of_loops = loop_derivatives(x[:, None], y[:, None], z[:, None] - heights_m, radii_m, steps)
    h, axial, h_z, axial_z = ((weights * part).sum(-1) for part in of_loops)
    sums = torch.stack((torch.stack((h, h_z)), torch.stack((axial, axial_z))))
    return field_and_slopes_by_torch(points_m[:, :2], sums)


def _loops(coil: PlainCoil, winding: Winding) -> tuple[Tensor, Tensor, Tensor]:
    """Heights, radii and weights of the loops of every rule, a row each; shorter rows end in loops that weigh nothing."""
    rows = []
    for rule in coil.rules:
        heights_m = winding.axial_pitch_m * (rule.axial.nodes - 0.5 * winding.axial_loops)
        radii_m = winding.radius_m + winding.radial_pitch_m * (rule.radial.nodes - 0.5 * winding.radial_loops)
        weights = rule.axial.weights[:, None] * rule.radial.weights
        parts = torch.broadcast_tensors(heights_m[:, None], radii_m, weights)
        rows.append(torch.stack(parts, dim=-1).flatten(0, 1))
    heights_m, radii_m, weights = padded(rows, 2).unbind(-1)
    return heights_m, radii_m, weights
