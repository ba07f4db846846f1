"""JSON of a magnet: its schema, and a reader in NumPy and SciPy that follows nothing but the conventions of the file."""

from __future__ import annotations

import copy
import json
from typing import Any

import jsonschema
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk

from estimator.calibration.result import Calibration
from estimator.export.json_model import calibration_schema

Pose = tuple[np.ndarray, np.ndarray]


@pytest.fixture(scope="module")
def document(magnet: Calibration, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    file = magnet.export("json", tmp_path_factory.mktemp("json") / "magnet.json")
    loaded: dict[str, Any] = json.loads(file.read_text())
    return loaded


def test_file_follows_its_schema(document):
    jsonschema.Draft202012Validator.check_schema(calibration_schema())
    jsonschema.validate(document, calibration_schema())
    broken = copy.deepcopy(document)
    broken["coils"][0]["radius_mm"] = 51.0
    with pytest.raises(jsonschema.ValidationError, match="radius_mm"):
        jsonschema.validate(broken, calibration_schema())


def test_another_reader_finds_the_field_of_predict(document, magnet, question):
    """The textbook formula loses digits far away; elsewhere it agrees to rounding."""
    near_m, currents_A = question.points_m[:18], list(question.currents_A.values())
    expected_T = magnet.field(near_m, question.currents_A, question.motion).numpy()
    motions = {name: numbers.numpy() for name, numbers in question.motion.items()}
    received_T = np.stack([field(document, motions, currents_A, point_m) for point_m in near_m.numpy()])
    assert (np.linalg.norm(received_T - expected_T, axis=1) / np.linalg.norm(expected_T, axis=1)).max() < 1e-9


def test_parameters_have_units_and_widths(document, magnet):
    radius = document["parameters"]["carried.radius_m"]
    assert (radius["value"], radius["unit"]) == (pytest.approx(0.051), "m")
    assert radius["sd"] == pytest.approx(1e-4, rel=0.2)
    assert radius["ci90_lower"] < 0.051 < radius["ci90_upper"]
    assert document["parameters"]["standing.radius_m"]["sd"] is None
    assert set(document["parameters"]) == set(magnet.rig.parameters)


def field(
    document: dict[str, Any], motions: dict[str, np.ndarray], currents_A: list[float], point_m: np.ndarray
) -> np.ndarray:
    delivered_A = np.array(document["delivered_A_per_A"]) @ currents_A + document["offset_A"]
    total_T = np.array(document["background_T"])
    for coil, current_A in zip(document["coils"], delivered_A, strict=True):
        rotation, translation_m = world_from_coil(document, coil, motions)
        point_coil_m = rotation.T @ (point_m - translation_m)
        total_T = total_T + current_A * rotation @ winding(coil, point_coil_m, document["mu0_T_m_per_A"])
    return total_T


def world_from_coil(document: dict[str, Any], coil: dict[str, Any], motions: dict[str, np.ndarray]) -> Pose:
    pose = pose_of(coil["world_from_base"])
    for mover in (mover for mover in document["movers"] if mover["name"] == coil["mover"]):
        numbers, table = motions[mover["name"]], mover["denavit_hartenberg"]
        if table is None:
            pose = chained(pose, (Rotation.from_rotvec(numbers[3:]).as_matrix(), numbers[:3]))
            continue
        for q, theta, a, d, alpha in zip(numbers, *table.values(), strict=True):
            pose = chained(pose, (Rotation.from_rotvec([0, 0, q + theta]).as_matrix(), np.array([0, 0, d])))
            pose = chained(pose, (Rotation.from_rotvec([alpha, 0, 0]).as_matrix(), np.array([a, 0, 0])))
    return chained(pose, pose_of(coil["flange_from_coil"]))


def pose_of(pose: dict[str, Any]) -> Pose:
    return np.array(pose["rotation"]), np.array(pose["translation_m"])


def chained(a: Pose, b: Pose) -> Pose:
    return a[0] @ b[0], a[0] @ b[1] + a[1]


def winding(coil: dict[str, Any], point_m: np.ndarray, mu0: float) -> np.ndarray:
    """Field per ampere by complete elliptic integrals (Simpson et al., NASA 2001)."""
    x, y, z0 = point_m
    rho = np.hypot(x, y)
    inner_m = coil["radius_m"] - coil["radial_pitch_m"] * coil["radial_loops"]
    length_m = coil["axial_pitch_m"] * coil["axial_loops"]
    d = np.hypot(max(inner_m - rho, rho - coil["radius_m"], 0.0), max(z0, -length_m - z0, 0.0))
    level = np.clip(int(np.floor(2 * np.log2(d))) - coil["first_level"], 0, len(coil["rule_of_level"]) - 1)
    rule = coil["rules"][coil["rule_of_level"][level]]
    nodes = {way: np.array(rule[f"{way}_nodes"]) for way in ("axial", "radial")}
    z = z0 - coil["axial_pitch_m"] * (nodes["axial"] - coil["axial_loops"] / 2)[:, None]
    a = coil["radius_m"] - coil["radial_pitch_m"] * (coil["radial_loops"] / 2 - nodes["radial"])
    weight = np.outer(rule["axial_weights"], rule["radial_weights"])
    alpha2, beta2 = (a - rho) ** 2 + z**2, (a + rho) ** 2 + z**2
    k, e = ellipk(1 - alpha2 / beta2), ellipe(1 - alpha2 / beta2)
    common = weight * mu0 / (2 * np.pi * np.sqrt(beta2))
    radial = (common * z / rho * (-k + (a**2 + rho**2 + z**2) / alpha2 * e)).sum()
    axial = (common * (k + (a**2 - rho**2 - z**2) / alpha2 * e)).sum()
    return np.array([radial * x / rho, radial * y / rho, axial])
