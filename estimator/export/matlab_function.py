"""A function for MATLAB and Octave: field, gradient and actuation matrix of a calibrated magnet at many points."""

from __future__ import annotations

import re
from dataclasses import astuple

from estimator.errors import InvalidInput, quoted
from estimator.export.plain_model import numbers_of
from estimator.export.request import Request
from estimator.export.templates import Filters, number, source_code
from estimator.frames import Transform
from estimator.rig.arms import DenavitHartenberg
from estimator.tensors import Tensor, torch
from estimator.units import MU0_T_M_PER_A

DEFINED = re.compile(r"^function .*?(\w+)\(", re.MULTILINE)
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


def matlab_function(request: Request) -> str:
    """The text of the file, after which the function is named.

    Raises:
        InvalidInput: A name that MATLAB does not take, or a rig with something that the function cannot express.
    """
    magnet, name = request.magnet, request.path.stem
    if not NAME.fullmatch(name):
        raise InvalidInput(
            f"name of a MATLAB function must have up to 63 letters, digits and underscores, a letter first; received {quoted(name)}"
        )
    model = magnet.model("matlab")
    text = source_code(
        magnet, model, "matlab_function.m.j2", FILTERS, name=name, quarter_mu0=number(0.25 * MU0_T_M_PER_A)
    )
    if name in DEFINED.findall(text)[1:]:
        raise InvalidInput(
            f"name of the function must not be that of a function inside it; received {quoted(name)}"
        )
    return text


def _row(values: Tensor) -> str:
    return f"[{' '.join(map(number, values))}]"


def _rows(matrix: Tensor) -> str:
    return f"[{'; '.join(' '.join(map(number, row)) for row in matrix)}]"


def _homogeneous(pose: Transform) -> str:
    last = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=torch.float64)
    return _rows(torch.cat((torch.cat((pose.rotation, pose.translation_m[:, None]), dim=1), last)))


def _table(joints: DenavitHartenberg | None) -> str:
    """Rows theta, a, d and alpha, or nothing."""
    return "[]" if joints is None else _rows(torch.tensor(astuple(joints), dtype=torch.float64))


FILTERS: Filters = {
    "row": _row,
    "column": lambda values: f"{_row(values)}'",
    "rows": _rows,
    "homogeneous": _homogeneous,
    "table": _table,
    "winding": lambda coil: numbers_of(coil.winding).items(),
    "pieces": lambda leads: (
        _rows(torch.tensor(leads, dtype=torch.float64).reshape(-1, 6)) if leads else "zeros(0, 6)"
    ),
    "capitalize_first": lambda line: line[:1].upper() + line[1:],
}
