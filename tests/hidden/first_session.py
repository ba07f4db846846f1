"""First sessions of a laboratory: a coil drawn from what `coilcal init` writes of it, read in the Earth's field by an ordinary probe.

Nothing here imports `estimator`: fields are by magpylib, frames by SciPy. The rig file says nothing of what is ordinary: a room's field, a zero
of the probe, a gain that is off by a per cent, a mount that is off by a millimetre and ten milliradians.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tests.independent.readings import coil_field_T

PLACE_SD_M, TILT_SD_RAD, RELATIVE_SD = 3e-3, np.deg2rad(2.0), 0.05  # of the priors that `coilcal init` writes
ORDINARY = ("earth", "zero", "gain", "gains", "shift", "turn")
CURRENTS = {"zero and two": (0.0, 0.5, 1.0), "both signs": (-1.0, -0.5, 0.0, 0.5, 1.0), "one": (1.0,)}
LEAST_FROM_WINDING_M = 6e-3


@dataclass(frozen=True)
class FirstSession:
    """A session and what is true of it.

    Attributes:
        answers: Of `coilcal init`, by the names of its questions.
        ordinary: What is there and not mentioned.
        protocol: Which currents were read.
        truth: Numbers of the coil that the readings have in common with the rig file, under coilcal's names, in SI.
        columns: Header of the readings.
        rows: One for each reading.
        points_m: Places in the world, where readings were taken.
        coil_field_T: Field of the coil alone there, at the largest current, with each mover at zero displacement.
    """

    answers: Mapping[str, object]
    ordinary: tuple[str, ...]
    protocol: str
    truth: Mapping[str, float]
    columns: tuple[str, ...]
    rows: np.ndarray
    points_m: np.ndarray
    coil_field_T: np.ndarray


@dataclass(frozen=True)
class _Coil:
    radius_m: float
    wire_radius_m: float
    axial: int
    radial: int

    def field_T(self, points_coil_m: np.ndarray, current_A: float) -> np.ndarray:
        return coil_field_T(
            points_coil_m, self.radius_m, self.wire_radius_m, self.axial, self.radial, current_A
        )


def first_session(seed: int) -> FirstSession:
    """Draw a laboratory and its first session."""
    rng = np.random.default_rng([541, seed])
    moved = ("coil", "sensor")[rng.integers(2)]
    motion = ("displacement", "pose")[rng.integers(2)]
    radius_mm, wire_mm = rng.uniform(25.0, 60.0), rng.uniform(0.3, 0.6)
    axial = float(rng.integers(15, 51))
    radial = float(rng.integers(6, max(7, min(24, int(0.6 * radius_mm / (2.0 * wire_mm))))))
    rim_mm = radius_mm * TILT_SD_RAD
    distance_mm = max(rng.uniform(20.0, 50.0), 4.0 * np.hypot(3.0, rim_mm) + 1.0)
    reach_mm, noise_uT, largest_A = rng.uniform(20.0, 50.0), rng.uniform(5.0, 40.0), rng.uniform(1.0, 5.0)
    answers = {
        "moved": moved,
        "motion": motion,
        "radius_mm": round(radius_mm, 1),
        "wire_radius_mm": round(wire_mm, 3),
        "axial_loops": axial,
        "radial_loops": radial,
        "distance_mm": round(distance_mm, 1),
        "reach_mm": round(reach_mm, 1),
        "noise_uT": round(noise_uT, 1),
        "largest_A": round(largest_A, 2),
    }
    coil = _Coil(
        1e-3 * radius_mm * (1.0 + RELATIVE_SD * _draw(rng)),
        1e-3 * wire_mm * (1.0 + RELATIVE_SD * _draw(rng)),
        max(1, round(axial + max(1.0, RELATIVE_SD * axial) * _draw(rng))),
        max(1, round(radial + max(0.5, RELATIVE_SD * radial) * _draw(rng))),
    )
    ordinary = tuple(name for name in ORDINARY if rng.random() < 0.3)
    protocol = tuple(CURRENTS)[rng.choice(3, p=(0.4, 0.4, 0.2))]
    return _recorded(answers, coil, ordinary, protocol, rng)


def _draw(rng: np.random.Generator) -> float:
    return float(np.clip(rng.normal(), -2.0, 2.0))


def _recorded(
    answers: Mapping[str, object],
    coil: _Coil,
    ordinary: tuple[str, ...],
    protocol: str,
    rng: np.random.Generator,
) -> FirstSession:
    is_coil_moved, is_pose = answers["moved"] == "coil", answers["motion"] == "pose"
    distance_m, reach_m = 1e-3 * float(answers["distance_mm"]), 1e-3 * float(answers["reach_mm"])  # type: ignore[arg-type]
    side = -1.0 if is_coil_moved else 1.0
    largest_A = float(answers["largest_A"])  # type: ignore[arg-type]

    off_m = PLACE_SD_M * np.array([_draw(rng) for _ in range(3)])
    tilt_rad = np.array([TILT_SD_RAD * _draw(rng), TILT_SD_RAD * _draw(rng), 0.0])
    turn = Rotation.from_rotvec(rng.normal(scale=10e-3, size=3) if "turn" in ordinary else np.zeros(3))
    shift_m = rng.normal(scale=1e-3, size=3) if "shift" in ordinary else np.zeros(3)

    n = 60
    moves_m = rng.uniform((-reach_m, -reach_m, 0.0), (reach_m, reach_m, reach_m), size=(n, 3)) * [
        1.0,
        1.0,
        side,
    ]
    turns_rad = rng.normal(scale=0.2, size=(n, 3)) if is_pose and rng.random() < 0.5 else np.zeros((n, 3))
    if is_pose:
        moves_m[:, 2] += side * distance_m
        flange = Rotation.from_rotvec(turns_rad)
        mounted = Rotation.from_rotvec(tilt_rad) * turn  # in the flange, and only its tilt is in the rig file
        world_from_body = flange * mounted
        places_m = moves_m + off_m + flange.apply(np.tile(shift_m, (n, 1)))
    else:
        world_from_body = Rotation.concatenate([Rotation.from_rotvec(tilt_rad)] * n)
        start_m = off_m + np.array([0.0, 0.0, side * distance_m])
        places_m = start_m + world_from_body.apply(turn.apply(moves_m))

    # The body that stands still is the world's origin; the other one is at `places_m`.
    points_coil_m = world_from_body.inv().apply(-places_m) if is_coil_moved else places_m
    is_clear = _clearance_m(points_coil_m, coil) > LEAST_FROM_WINDING_M
    moves_m, turns_rad, points_coil_m = moves_m[is_clear], turns_rad[is_clear], points_coil_m[is_clear]
    world_from_body = world_from_body[is_clear]
    per_ampere_T = coil.field_T(points_coil_m, 1.0)

    earth_T = rng.uniform(25e-6, 65e-6) * _direction(rng) if "earth" in ordinary else np.zeros(3)
    zero_T = rng.normal(scale=50e-6, size=3) if "zero" in ordinary else np.zeros(3)
    gains = np.ones(3)
    if "gain" in ordinary:
        gains = gains * (1.0 + rng.normal(scale=0.01))
    if "gains" in ordinary:
        gains = gains * (1.0 + rng.normal(scale=0.01, size=3))
    noise_T = 1e-6 * float(answers["noise_uT"]) * np.exp(rng.normal(scale=0.2))  # type: ignore[arg-type]

    rows, t_s = [], 0.0
    for i in rng.permutation(len(moves_m)) if rng.random() < 0.5 else range(len(moves_m)):
        for share in CURRENTS[protocol]:
            of_coil_T = per_ampere_T[i] * share * largest_A
            if is_coil_moved:
                shown_T = world_from_body[i].apply(of_coil_T) + earth_T
            else:
                shown_T = world_from_body[i].inv().apply(of_coil_T + earth_T)
            read_T = gains * shown_T + zero_T + rng.normal(scale=noise_T, size=3)
            rows.append([t_s, *moves_m[i], *turns_rad[i], share * largest_A, *read_T])
            t_s += 2.0
    columns = ("t_s", *(f"arm1_{axis}_m" for axis in "xyz"), *(f"arm1_r{axis}_rad" for axis in "xyz"))
    columns = (*columns, "coil1_current_A", "Bx_T", "By_T", "Bz_T")

    truth = {
        "coil1.radius_m": coil.radius_m,
        "coil1.wire_radius_m": coil.wire_radius_m,
        "coil1.axial_loops": coil.axial,
        "coil1.radial_loops": coil.radial,
    }
    points_m, field_T = np.zeros((0, 3)), np.zeros((0, 3))
    if not is_pose:
        body = "coil1.world_from_coil0" if is_coil_moved else "hall.world_from_sensor0"
        truth |= {f"{body}.{axis}_m": value for axis, value in zip("xyz", start_m, strict=True)}
        truth |= {f"{body}.tilt_{axis}_rad": value for axis, value in zip("xy", tilt_rad, strict=False)}
        if (
            is_coil_moved
        ):  # where the sensor would be seen from the coil at zero displacement, for places among the readings
            points_m = Rotation.from_rotvec(tilt_rad).apply(points_coil_m[:8]) + start_m
            field_T = Rotation.from_rotvec(tilt_rad).apply(largest_A * per_ampere_T[:8])
        else:
            points_m, field_T = points_coil_m[:8], largest_A * per_ampere_T[:8]
    return FirstSession(answers, ordinary, protocol, truth, columns, np.array(rows), points_m, field_T)


def _clearance_m(points_coil_m: np.ndarray, coil: _Coil) -> np.ndarray:
    """Distance from the box of the winding."""
    rho_m, z_m = np.hypot(points_coil_m[:, 0], points_coil_m[:, 1]), points_coil_m[:, 2]
    inner_m = coil.radius_m - 2.0 * coil.wire_radius_m * coil.radial
    length_m = 2.0 * coil.wire_radius_m * coil.axial
    beside_m = np.maximum(0.0, np.maximum(rho_m - coil.radius_m, inner_m - rho_m))
    before_m = np.maximum(0.0, np.maximum(z_m, -length_m - z_m))
    return np.asarray(np.hypot(beside_m, before_m))


def _direction(rng: np.random.Generator) -> np.ndarray:
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))
