"""A laboratory whose sensor goes anywhere, and the same windings as loops of magpylib: the second formula of every test beside.

The coil stands in the world's origin with its axis along z, so that its frame is the world's; the sensor reports its pose. Fields come
through the whole model, from a rig file with an `effects:` section, so that a test of an effect is also one of where it acts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import magpylib
import numpy as np
import torch
import yaml

from estimator.effects import EFFECTS
from estimator.effects.base import Kind
from estimator.effects.circumstances import Extent
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig_files.read import rig_from_text
from estimator.units import MU0_T_M_PER_A

RIG = """
schema_version: 1
name: laboratory
movers: {mapper: {motion: pose}}
coils:
  coil: {radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 6, radial_loops: 4, superconducting: true}
  other: {radius_mm: 30, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3, world_from_coil: {x_mm: 120, ry_deg: -90}}
sensors:
  probe: {carried_by: mapper, noise_uT: 5}
"""
DISPLACED = (
    RIG.replace("{mapper: {motion: pose}}", "{arm: {motion: displacement}}")
    .replace("  coil: {radius", "  coil: {carried_by: arm, world_from_coil0: {z_mm: -60}, radius")
    .replace("carried_by: mapper, ", "")
)
# Around the coil: in front, beside, behind, in the bore; none on a symmetry axis but the first.
POINTS_M = np.array(
    [
        [0.0, 0.0, 0.03],
        [0.012, -0.021, 0.025],
        [-0.031, 0.017, 0.04],
        [0.058, 0.023, -0.002],
        [0.02, 0.05, -0.035],
        [-0.01, 0.006, -0.003],
        [-0.044, -0.047, 0.012],
    ]
)
# Every effect that adds a field or changes a winding, of a size that shows.
SOURCES = {
    "axial_pitch": {"excess": 0.05},
    "radial_pitch": {"excess": -0.1},
    "turns_gradient": {"slope": 0.2},
    "short_layer": {"missing": 0.4, "at_front": 1.0},
    "winding_misstated": {"radius": 0.02, "wire": -0.03, "axial_loops": 0.05, "radial_loops": -0.04},
    "reversed_layer": {"share": 0.5, "depth": 0.4},
    "hidden_winding": {"turns": -0.2, "radius": 1.3, "middle": -0.4, "length": 0.3},
    "coil_ovality": {"cos2": 0.02, "sin2": -0.01},
    "winding_sheared": {"shear_x": 0.3, "shear_y": -0.1},
    "magnetised_link": {"moment_x_A_m2": 0.2, "moment_z_A_m2": -0.3, "y_m": 0.02, "z_m": -0.09},
    "lead_wire": {"gap_m": 0.01, "azimuth_rad": 2.0, "length_m": 0.2},
    "iron_core": {"share": 0.2},
    "core_saturation": {"share": 0.2, "loss_per_A2": 0.01},
    "cross_magnetisation": {"strength": 0.9, "radius_m": 0.006, "length_m": 0.02, "front_m": -0.004,
        "saturation_T": 1.8},
    "dipole_model": {"weight": 0.5},
    "spherical_sum": {"weight": 0.5},
    "background_field": {"x_T": 1e-5, "z_T": 4e-5},
    "background_drift": {"x_T_per_h": 1e-5, "z_T_per_h": 4e-5},
    "background_gradient": {"xx_T_per_m": 2e-4, "yy_T_per_m": -5e-5, "xz_T_per_m": 1e-4, "yz_T_per_m": 3e-5},
    "background_step": {"x_T": 1e-5, "z_T": 4e-5, "since_h": 0.0},
    "background_spell": {"x_T": 1e-5, "z_T": 4e-5, "since_h": 0.0, "until_h": 1e6},
    "periodic_interference": {"cos_x_T": 1e-5, "sin_z_T": 4e-5, "frequency_per_h": 1.7},
    "iron_plate": {"strength": 0.4, "axis": 0.0, "tilt_1_rad": 0.7, "tilt_2_rad": -0.4, "distance_m": 0.12},
    "pierced_plate": {"strength": 0.8, "step_T": 1e-4, "axis": 0.0, "tilt_1_rad": 0.7, "tilt_2_rad": -0.4,
        "x_m": 0.05, "y_m": 0.04, "z_m": -0.04, "radius_m": 0.03},
    "filament_magnetisation": {"susceptibility": 0.3, "axial_T": 0.02, "radial_T": 0.01, "fan_T": -0.03},
    "iron_body": {"volume_m3": 2e-6, "x_m": 0.05, "y_m": -0.06, "z_m": 0.03},
    "second_iron_body": {"volume_m3": 1e-6, "x_m": -0.05, "y_m": -0.07, "z_m": 0.04},
    "coil_harmonics": {"degree1_cos1_T_per_A": 1e-6, "degree2_sin2_T_per_A": 2e-6, "middle_z_m": 0.02,
        "reach_m": 0.05},
    "coil_multipoles": {"degree2_cos0_T_per_A": 1e-6, "degree2_sin1_T_per_A": 2e-6, "middle_z_m": -0.01,
        "reach_m": 0.05},
    "coil_bore": {"degree0_slope_cos1_T_per_A": 1e-6, "degree1_sin2_T_per_A": 2e-6, "middle_z_m": 0.02,
        "along_x": 0.6, "along_y": 0.64, "radius_m": 0.05, "length_m": 0.3},
    "room_bore": {"degree0_uniform_cos0_T": 1e-5, "degree1_cos2_T": 2e-5, "radius_m": 0.05, "length_m": 0.3},
    "room_harmonics": {"degree2_cos0_T": 1e-5, "degree2_cos2_T": 2e-5, "middle_x_m": 0.01, "reach_m": 0.05},
    "room_answers": {"degree1_cos1_T_per_A": 2e-6, "degree2_sin1_T_per_A": 2e-6, "middle_x_m": 0.01,
        "reach_m": 0.05},
    "room_steps": {"degree1_x_T": 1e-5, "degree2_z_T": 2e-5, "since1_h": 0.6, "since2_h": 1.1},
    "room_wanders": {"degree1_x_T": 1e-5, "degree2_z_T": 2e-5, "duration_h": 3.0},
}  # fmt: skip
MU0_RATIO = MU0_T_M_PER_A / magpylib.mu_0  # CODATA of different years
Field = Callable[[np.ndarray], np.ndarray]  # points (n, 3) -> flux density (n, 3)


@dataclass(frozen=True)
class Loops:
    """Loops about one axis, each with its own current for one ampere in the coil."""

    radius_m: np.ndarray
    height_m: np.ndarray
    current: np.ndarray

    def field_T(self, points_m: np.ndarray) -> np.ndarray:
        """Sum of magpylib's loops, per ampere."""
        circles = [
            magpylib.current.Circle(diameter=2.0 * a, current=i, position=(0.0, 0.0, z))
            for a, z, i in zip(self.radius_m, self.height_m, self.current, strict=True)
        ]
        return MU0_RATIO * magpylib.getB(circles, points_m, sumup=True, squeeze=False).reshape(-1, 3)

    @property
    def moment_m2(self) -> float:
        """Current times area."""
        return float(np.sum(np.pi * self.radius_m**2 * self.current))


def winding(
    radius_m: float = 0.04,
    axial: int = 6,
    radial: int = 4,
    axial_pitch_m: float = 1e-3,
    radial_pitch_m: float = 1e-3,
) -> Loops:
    """The coil of the rig, or another: from the front face back and from the outermost layer in (Osinde et al., eq 9-10)."""
    heights_m = -axial_pitch_m * (np.arange(axial) + 0.5)
    radii_m = radius_m - radial_pitch_m * (np.arange(radial) + 0.5)
    height, radius = (v.ravel() for v in np.meshgrid(heights_m, radii_m, indexing="ij"))
    return Loops(radius, height, np.ones(len(radius)))


def polyline_T(vertices_m: np.ndarray, points_m: np.ndarray, current_A: float = 1.0) -> np.ndarray:
    """Field of straight pieces of wire by magpylib."""
    wire = magpylib.current.Polyline(vertices=vertices_m, current=current_A)
    return MU0_RATIO * wire.getB(points_m, squeeze=False).reshape(-1, 3)


def dipole_T(moment_A_m2: np.ndarray, at_m: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """Field of a point dipole by magpylib."""
    dipole = magpylib.misc.Dipole(moment=moment_A_m2, position=at_m)
    return MU0_RATIO * dipole.getB(points_m, squeeze=False).reshape(-1, 3)


def label_of(name: str) -> str:
    """An effect at the first coil, or in the room."""
    return f"{name}[{'room' if EFFECTS[name].kind is Kind.ROOM else 'coil'}]"


def effects_text(effects: Mapping[str, Mapping[str, float]]) -> str:
    """`effects:` and `corrections:` of a rig file; what is not given is at its null."""
    entries: dict[str, dict[str, dict[str, float]]] = {}
    for label, given in effects.items():
        effect = EFFECTS[label.partition("[")[0]]
        nulls = {q.key: q.null for q in effect.quantities(Extent())}
        assert set(given) <= set(nulls), (label, set(nulls))
        section = entries.setdefault("corrections" if effect.is_correction else "effects", {})
        section[label] = {key: float(value) for key, value in {**nulls, **given}.items()}
    return yaml.safe_dump(entries, sort_keys=False) if entries else ""


def readings(
    points_m: np.ndarray,
    current_A: object = (2.0, 0.0),
    *,
    turn_rad: object = (0.0, 0.0, 0.0),
    time_s: np.ndarray | None = None,
    temperature_C: Mapping[str, np.ndarray] | None = None,
    mover: str = "mapper",
) -> Observations:
    """Readings without field at positions and rotation vectors of the mover, by one sensor."""
    n = len(points_m)
    motion = np.concatenate((points_m, np.broadcast_to(turn_rad, (n, 3))), axis=1)
    current = np.array(np.broadcast_to(current_A, (n, np.shape(current_A)[-1])), dtype=float)
    warm = {name: torch.tensor(value, dtype=torch.float64) for name, value in (temperature_C or {}).items()}
    return Observations.of(
        torch.from_numpy(current),
        {mover: torch.from_numpy(motion)},
        torch.full((n, 3), 1e-3, dtype=torch.float64),
        time_s=torch.tensor(np.arange(n) if time_s is None else time_s, dtype=torch.float64),
        temperature_C=warm,
    )


def model_of(
    observations: Observations, effects: Mapping[str, Mapping[str, float]], rig: str = RIG
) -> MeasurementModel:
    """The model of a rig with effects, with the full sum over the loops."""
    text = rig + (effects_text(effects) if effects else "")
    return MeasurementModel.build(rig_from_text(text), observations, tolerance=1e-13)


def predicted_T(
    observations: Observations, effects: Mapping[str, Mapping[str, float]] | None = None, rig: str = RIG
) -> np.ndarray:
    """What the sensor reads."""
    model = model_of(observations, effects or {}, rig)
    values = {k: torch.tensor(v, dtype=torch.float64) for k, v in model.rig.nominal_values().items()}
    return model.predict(values).expand(len(observations), 3).numpy()


def added_T(
    observations: Observations, effects: Mapping[str, Mapping[str, float]], rig: str = RIG
) -> np.ndarray:
    """What effects add to the readings."""
    return predicted_T(observations, effects, rig) - predicted_T(observations, None, rig)


def assert_same_field(actual_T: np.ndarray, expected_T: np.ndarray, rtol: float = 1e-9) -> None:
    """Vectors agree to a share of each vector's own length."""
    norm = np.linalg.norm(expected_T, axis=-1)
    assert actual_T.shape == expected_T.shape
    assert (norm > 0.0).all()
    error = np.linalg.norm(actual_T - expected_T, axis=-1) / norm
    assert error.max() < rtol, error
