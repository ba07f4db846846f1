"""A solenoid of three coils in series and four probes that are stepped through its bore, past an iron end plate that the rig file lacks.

Behind the plate little of the field is left, and in front of it there is more than the coils make. Fields come from magpylib's loops and
the integral equations of `pierced_sheet`; nothing is shared with the estimator.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.hidden.bore_map import write_map
from tests.hidden.coil import Winding, blocks_of, circular_field
from tests.hidden.pierced_sheet import pierced_T
from tests.hidden.protocols import Array

CENTRE = Winding(radius_m=0.1, wire_radius_m=1e-3, axial_loops=150, radial_loops=4)
END = Winding(radius_m=0.11, wire_radius_m=1e-3, axial_loops=15, radial_loops=10)
COILS = {
    "far_end": (END, -0.33),
    "centre": (CENTRE, 0.0),
    "near_end": (END, 0.05),
}  # and where its front face is
COIL_TEXT = """
  {name}:
    radius_mm: {{prior: {{normal: {{mean: {radius}, sd: 0.3}}}}}}
    wire_radius_mm: 1
    axial_loops: {axial}
    radial_loops: {radial}
    current_gain: {gain}
    world_from_coil: {{z_mm: {{prior: {{normal: {{mean: {front}, sd: 0.5}}}}}}}}
"""
GAIN = "{prior: {normal: {mean: 1, sd: 0.005}}}"
ARMS_MM = {"probe0": (0.0, 0.0), "probe1": (12.0, 0.0), "probe2": (0.0, 24.0), "probe3": (-36.0, 0.0)}
CURRENT_A = 10.0
UNLIKE = 0.004  # errors of the probes' gains and axes
STEP_M, BESIDE_M = 0.016, (-0.01, 0.0, 0.01)


def write_plated_solenoid(folder: Path, plate_m: float, opening_m: float, rng: np.random.Generator) -> None:
    """The rig file and the readings.

    Args:
        folder: Holds both afterwards.
        plate_m: Height of the plate above the front face of the centre coil.
        opening_m: Radius of its opening, which lets the probes through.
        rng: Of the noise.
    """
    heights_m = np.arange(-0.5, plate_m + 0.3, STEP_M)
    heights_m = heights_m[np.abs(heights_m - plate_m) > 0.25 * STEP_M]  # in its plane the quadrature fails
    mapper_m = np.array([(x, y, z) for z in heights_m for x in BESIDE_M for y in BESIDE_M])
    at_m = np.repeat(mapper_m, len(ARMS_MM), axis=0)
    probe = list(ARMS_MM) * len(mapper_m)
    arm_m = 1e-3 * np.array([(*ARMS_MM[name], 0.0) for name in probe])
    field_T = CURRENT_A * pierced_T(_coils_T, plate_m, opening_m, at_m + arm_m)
    of_probe = np.tile(np.arange(len(ARMS_MM)), len(mapper_m))
    field_T = np.einsum(
        "nij,nj->ni", (np.eye(3) + UNLIKE * rng.standard_normal((len(ARMS_MM), 3, 3)))[of_probe], field_T
    )
    texts = [
        COIL_TEXT.format(
            name=name,
            radius=1e3 * coil.radius_m,
            axial=coil.axial_loops,
            radial=coil.radial_loops,
            gain=GAIN if name == "far_end" else "{tied_to: far_end.current_gain}",
            front=1e3 * front_m,
        )
        for name, (coil, front_m) in COILS.items()
    ]
    current_A = {name: np.full(len(at_m), CURRENT_A) for name in COILS}
    write_map(folder, "coils:" + "".join(texts), current_A, at_m, field_T, rng, probe, ARMS_MM)


def _coils_T(points_m: Array) -> Array:
    parts = [
        circular_field(blocks_of(coil))(points_m - [0.0, 0.0, front_m]) for coil, front_m in COILS.values()
    ]
    return np.sum(parts, axis=0)
