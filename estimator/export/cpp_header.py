"""A C++17 header without dependencies: field, gradient, actuation matrix and standard deviation of a calibrated magnet."""

from __future__ import annotations

from torch import Tensor

from estimator.export.labels import identifier, plain_words
from estimator.export.magnet import Magnet
from estimator.export.templates import Filters, number, template
from estimator.field.winding import DEFAULT_TOLERANCE
from estimator.field.zones import ZONES_PER_OCTAVE
from estimator.frames import Transform
from estimator.units import MU0_T_M_PER_A


def cpp_header(magnet: Magnet) -> str:
    """The text of the header.

    Raises:
        InvalidInput: The rig has something that the header cannot express.
    """
    model = magnet.model("cpp")
    return template("cpp_header.hpp.j2", FILTERS).render(
        model=model,
        changes=magnet.changes,
        title=plain_words(model.name),
        name=identifier(model.name),
        regions=magnet.regions,
        origin=magnet.origin,
        coil_names=", ".join(coil.name for coil in model.coils),
        mover_names=", ".join(mover.name for mover in model.movers) or "none",
        currents=", ".join(["1.0"] * len(model.coils)),
        mu0=MU0_T_M_PER_A,
        tolerance=f"{DEFAULT_TOLERANCE:g}",
        zones_per_octave=ZONES_PER_OCTAVE,
    )


def _numbers(values: Tensor | tuple[float, ...]) -> str:
    return "{" + ", ".join(map(number, values)) + "}"


def _matrix(rows: Tensor) -> str:
    return "{ {" + ", ".join(map(_numbers, rows)) + "} }"


def _pose(pose: Transform) -> str:
    return "{ " + _matrix(pose.rotation) + ", " + _numbers(pose.translation_m) + " }"


FILTERS: Filters = {"numbers": _numbers, "array": _numbers, "matrix": _matrix, "pose": _pose}
