"""mag_manip's multipole model, by a reader written from the layout in its header and the potential of its sources."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
import yaml
from scipy.special import eval_legendre
from torch import Tensor

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.export.request import Grid
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

ENDS_M = np.linspace(-0.015, 0.015, 3)
BOX = Grid(ENDS_M, ENDS_M, ENDS_M + 0.005)
STEP_M = 1e-5
RIG = """
schema_version: 1
name: a round coil and a rectangular one
movers: {stage: {motion: pose}}
coils:
  round: {radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 20, radial_loops: 6, world_from_coil: {z_mm: -40, rx_deg: 5}}
  square: {model: rectangular, carried_by: stage, inner_side_x_mm: 60, inner_side_y_mm: 45, wire_radius_mm: 0.5, axial_loops: 8,
           radial_loops: 5, flange_from_coil: {y_mm: 60, rx_deg: 90}, lead_in_mm: [[300, 0, 5], [40, 0, 0]],
           lead_out_mm: [[40, 0, 0], [300, 0, 0]]}
sensors: {hall: {noise_uT: 20}}
"""


@pytest.fixture(scope="module")
def model(calibrated: Callable[[Rig], Calibration]) -> Calibration:
    return calibrated(rig_from_text(RIG))


@pytest.fixture(scope="module")
def motion() -> dict[str, Tensor]:
    return {"stage": torch.tensor([0.0, 0.004, 0.0, 0.0, 0.0, 0.1], dtype=torch.float64)}


def field_T(document: dict[str, Any], coil: str, points_m: np.ndarray) -> np.ndarray:
    """Minus the gradient of the sum of A_n r^n P_n(cos) and B_n r^-(n + 1) P_n(cos), by the derivatives of Legendre's polynomials."""
    total = np.zeros_like(points_m)
    for name in document[coil]["Source_List"]:
        source = document[coil][name]
        assert (source["A_Coeff"] is None) != (
            source["B_Coeff"] is None
        )  # 3.0.0 asks for one and refuses both
        direction = np.array(source["Source_Direction"])
        direction /= np.linalg.norm(direction)
        away_m = points_m - np.array(source["Source_Position"])
        r_m = np.linalg.norm(away_m, axis=1)
        outwards = away_m / r_m[:, None]
        cosine = outwards @ direction
        for n, a in enumerate(source["A_Coeff"], start=1):
            value = eval_legendre(n, cosine)
            slope = n * (cosine * value - eval_legendre(n - 1, cosine)) / (cosine**2 - 1.0)
            size = (a * r_m ** (n - 1))[:, None]
            total -= size * ((n * value - cosine * slope)[:, None] * outwards + slope[:, None] * direction)
    return total


def test_field_and_gradient_are_those_of_predict_to_what_the_header_says(model, motion, tmp_path):
    path = model.export("mpem", tmp_path / "mpem.yaml", grid=BOX, motion=motion)
    text = path.read_text(encoding="utf-8")
    document = yaml.safe_load(text)
    assert document["System_Name"] == "a round coil and a rectangular one"
    assert document["Coil_List"] == ["Coil_0", "Coil_1"]
    np.testing.assert_allclose(document["Workspace_Dimensions"], [[-0.015, 0.015]] * 2 + [[-0.01, 0.02]])
    low_m, high_m = np.array(document["Workspace_Dimensions"]).T
    points_m = np.random.default_rng(5).uniform(low_m, high_m, (12, 3))
    told = [float(words.rstrip(".").split()[-1]) for words in text.splitlines()[1].split(": ")[1].split(", ")]
    assert max(told) < 1e-5
    for number, coil in enumerate(("round", "square")):
        expected_T = model.field(torch.from_numpy(points_m), {coil: 1.0}, motion).numpy()
        found_T = field_T(document, f"Coil_{number}", points_m)
        largest_T = np.linalg.norm(expected_T, axis=1).max()
        assert np.abs(found_T - expected_T).max() < 2e-5 * largest_T
        gradient = model.gradient(torch.from_numpy(points_m), {coil: 1.0}, motion).numpy()
        for axis, step in enumerate(STEP_M * np.eye(3)):
            ahead, behind = (field_T(document, f"Coil_{number}", points_m + way * step) for way in (1, -1))
            slope = (ahead - behind) / (2.0 * STEP_M)
            assert np.abs(slope - gradient[:, :, axis]).max() < 1e-4 * np.abs(gradient).max()


def test_what_multipoles_cannot_hold_is_refused(model, motion, tmp_path):
    path = tmp_path / "mpem.yaml"
    wide_m = np.linspace(-0.06, 0.06, 2)
    around = Grid(wide_m, wide_m, np.linspace(-0.034, -0.028, 2))
    with pytest.raises(
        InvalidInput, match="must lie well away from the windings for multipoles; with degree 12"
    ):
        model.export("mpem", path, grid=around, motion=motion)
    inside = Grid(np.linspace(0.03, 0.05, 2), np.linspace(-0.01, 0.01, 2), np.linspace(-0.06, -0.044, 2))
    with pytest.raises(InvalidInput, match="grid of mpem must lie outside the windings"):
        model.export("mpem", path, grid=inside, motion=motion)
    with pytest.raises(
        InvalidInput,
        match="two or more points along each axis, whose ends are the workspace; received 3 x 1 x 3",
    ):
        model.export("mpem", path, grid=Grid(ENDS_M, ENDS_M[:1], ENDS_M), motion=motion)
