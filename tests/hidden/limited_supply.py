"""A supply that gives no more than so many ampere, whatever is commanded; the rig file knows of no limit."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.coil import CoilField, Winding, blocks_of, circular_field
from tests.hidden.protocols import Array

WINDING = Winding(0.0485, 0.00046, 46, 22)
TILT_RAD = (0.012, -0.02, 0.0)
DISTANCE_M = 0.045  # of the front face from the sensor, as the rig file states it
FRONT_M = np.array([0.0015, -0.001, -0.0462])  # where it is
NOISE_T = 15e-6

_RIG = """schema_version: 1
name: a supply with a limit
movers:
  arm1: {motion: displacement, displacement_frame: end_effector}
coils:
  coil1:
    carried_by: arm1
    radius_mm: {value: 48, prior: {normal: {mean: 48, sd: 2}}}
    wire_radius_mm: {value: 0.46, prior: {normal: {mean: 0.46, sd: 0.02, lower: 0.2}}}
    axial_loops: {value: 45, prior: {normal: {mean: 45, sd: 2, lower: 1}}}
    radial_loops: {value: 22, prior: {normal: {mean: 22, sd: 1, lower: 1}}}
    world_from_coil0:
      x_mm: {prior: {normal: {mean: 0, sd: 3}}}
      y_mm: {prior: {normal: {mean: 0, sd: 3}}}
      z_mm: {prior: {normal: {mean: -45, sd: 3}}}
      tilt_x_deg: {prior: {normal: {mean: 0, sd: 2}}}
      tilt_y_deg: {prior: {normal: {mean: 0, sd: 2}}}
sensors:
  hall:
    noise_uT: {prior: {log_normal: {median: 20, relative_sd: 0.5}}}
    world_from_sensor: {x_mm: 0, y_mm: 0, z_mm: 0, rx_rad: 0, ry_rad: 0, rz_rad: 0}
"""


@dataclass(frozen=True)
class LimitedSupply:
    """A session: the same currents one after another at each of some places.

    Attributes:
        commanded_A: Currents of a cycle.
        limit_A: What the supply gives at most, of either sign.
        places_m: Displacements of the coil.
        field_T: What the sensor shows; place by current by component, noise included.
    """

    commanded_A: Array
    limit_A: float
    places_m: Array
    field_T: Array

    @classmethod
    def drawn(cls, commanded_A: tuple[float, ...], limit_A: float, n_places: int, seed: int) -> LimitedSupply:
        """The coil passes places in random order."""
        rng = np.random.default_rng([54, seed])
        places_m = rng.uniform((-0.035, -0.035, -0.012), (0.035, 0.035, 0.02), (n_places, 3))
        currents_A = np.array(commanded_A)
        coil = circular_field(blocks_of(WINDING))
        field_T = np.clip(currents_A, -limit_A, limit_A)[:, None] * field_per_A(coil, places_m)[:, None]
        noise_T = NOISE_T * rng.normal(size=field_T.shape)
        return cls(currents_A, limit_A, places_m, field_T + noise_T)

    def write(self, folder: Path) -> None:
        """Write `rig.yaml` and `readings.csv`; every fifth place is for validation."""
        (folder / "rig.yaml").write_text(_RIG)
        lines = ["t_s,sensor,coil1_current_A,arm1_x_m,arm1_y_m,arm1_z_m,Bx_T,By_T,Bz_T,set"]
        for i, place_m in enumerate(self.places_m):
            for j, current_A in enumerate(self.commanded_A):
                time_s = 2.0 * (len(self.commanded_A) * i + j)
                numbers = (current_A, *place_m, *self.field_T[i, j])
                kept = "validation" if i % 5 == 4 else "calibration"
                lines.append(f"{time_s:g},hall,{','.join(f'{v:.10g}' for v in numbers)},{kept}")
        (folder / "readings.csv").write_text("\n".join(lines) + "\n")


def field_per_A(coil: CoilField, displacement_m: Array) -> Array:
    """Field of one ampere at the sensor, in the room, which is the sensor's frame.

    References: Osinde et al., eq 18-22: p = -dt - world_from_coil0^T t, along the axes of the coil.
    """
    turn = Rotation.from_rotvec(TILT_RAD).as_matrix()
    return np.asarray(coil(-displacement_m - FRONT_M @ turn) @ turn.T)
