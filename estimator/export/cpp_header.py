"""A C++17 header without dependencies: field, gradient, actuation matrix and standard deviation of a calibrated magnet."""

from __future__ import annotations

from estimator.export.labels import identifier
from estimator.export.plain_model import PlainCoil, numbers_of
from estimator.export.request import Request
from estimator.export.templates import Filters, number, source_code
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A


def cpp_header(request: Request) -> str:
    """The text of the header.

    Raises:
        InvalidInput: The rig has something that the header cannot express.
    """
    magnet = request.magnet
    model = magnet.model("cpp")
    return source_code(
        magnet,
        model,
        "cpp_header.hpp.j2",
        FILTERS,
        n_numbers=max(len(numbers_of(coil.winding)) for coil in model.coils),
        changes=magnet.changes,
        name=identifier(model.name),
        currents=", ".join(["1.0"] * len(model.coils)),
        mu0=MU0_T_M_PER_A,
    )


def _numbers(values: Tensor | tuple[float, ...]) -> str:
    return "{" + ", ".join(map(number, values)) + "}"


def _rows(rows: Tensor) -> str:
    return "{" + ", ".join(map(_numbers, rows)) + "}"


def _matrix(rows: Tensor) -> str:
    return "{ " + _rows(rows) + " }"


def _pose(pose: Transform) -> str:
    return "{ " + _matrix(pose.rotation) + ", " + _numbers(pose.translation_m) + " }"


def _sides(coil: PlainCoil) -> str:
    """Whether a coil has sides and round corners, then its sides and corner radius."""
    winding = coil.winding
    if isinstance(winding, Winding):
        return "false, false, 0.0, 0.0, 0.0"
    sizes_m = (winding.side_x_m, winding.side_y_m, winding.corner_radius_m)
    return f"true, {str(winding.is_rounded).lower()}, {', '.join(map(number, sizes_m))}"


FILTERS: Filters = {
    "numbers": _numbers,
    "array": _numbers,
    "matrix": _matrix,
    "table": _rows,
    "pose": _pose,
    "sides": _sides,
    "radius": lambda coil: coil.winding.radius_m if isinstance(coil.winding, Winding) else 0.0,
    "padded": lambda row, n: torch.cat((row, row.new_zeros(n - len(row)))),
}
