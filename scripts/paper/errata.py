"""A number for each quantitative erratum of the paper; `docs/paper.md` explains them.

Run `python -m scripts.paper.errata`. It takes seconds and needs no data.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from scipy.optimize import minimize

from estimator import load_plan, load_rig
from estimator.field.literal import literal_field_per_ampere
from estimator.field.loop import loop_field
from estimator.field.winding import Winding, winding_field_per_ampere
from estimator.field.winding_shape import choose_rule
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.plan import observations_of
from estimator.rig.coordinates import Coordinates
from scripts.paper.tables import CURRENT_A, NAMES, TRUTH, table
from tests.independent.readings import perfect_readings_T

ROOT = Path(__file__).resolve().parents[2]
MU0 = 4e-7 * np.pi
TILTED = {"x_m": 0.0, "y_m": 0.0, "z_m": -0.04, "tilt_x_rad": 0.02, "tilt_y_rad": -0.01}


def small_modulus() -> str:
    """Eq 8 beside the exact loop: the radial component of the form for small k^2 is 9/8 k^2 too small."""
    rows = []
    for k2 in (0.04, 0.01, 0.0025):
        radius_m, sine = 0.05, np.sin(0.6)
        s = k2 / (4.0 - 2.0 * k2)  # of a r sin(theta) / (a^2 + r^2)
        r_m = radius_m * (sine - np.sqrt(sine**2 - 4.0 * s**2)) / (2.0 * s)
        x, z = r_m * sine, r_m * np.cos(0.6)
        shape = (2.0 * radius_m**2 + 2.0 * r_m**2 + radius_m * x) / (
            radius_m**2 + r_m**2 + 2.0 * radius_m * x
        ) ** 2.5
        approximate_T = MU0 * radius_m**2 * np.cos(0.6) / 4.0 * shape
        field_T = loop_field(torch.tensor([[x, 0.0, z]]).double(), torch.tensor(radius_m).double())[0].numpy()
        exact_T = (field_T[0] * x + field_T[2] * z) / r_m
        error = approximate_T / exact_T - 1.0
        rows.append((f"{k2:g}", f"{100 * error:.3f} %", f"{error / k2:.3f}"))
    return table("Eq 8: error of its radial component", ("k^2", "relative error", "error / k^2"), rows)


def literal_sum() -> str:
    """Eq 13 as printed beside the sum of vectors, in a workspace of 100 x 100 x 50 mm at several distances."""
    one = torch.ones((), dtype=torch.float64)
    winding = Winding(0.051 * one, 48.0 * one, 25.0 * one, 0.98e-3 * one, 0.98e-3 * one)
    rows = []
    for near_m in (0.015, 0.04, 0.06, 0.1, 0.2):
        axes = [
            torch.linspace(*ends, 20).double()
            for ends in ((-0.05, 0.05), (-0.05, 0.05), (near_m, near_m + 0.05))
        ]
        points_m = torch.cartesian_prod(*axes)
        rule = choose_rule(winding, points_m)
        right = winding_field_per_ampere(points_m, winding, rule)
        error = (literal_field_per_ampere(points_m, winding, rule) - right).norm(dim=-1)
        size = right.norm(dim=-1)
        rms = float(error.square().mean().sqrt() / size.square().mean().sqrt())
        rows.append(
            (f"{1e3 * near_m:.0f}", f"{100 * rms:.1f} %", f"{100 * float((error / size).max()):.1f} %")
        )
    title = "Eq 13 taken literally, coil of Table 3, workspace of 100 x 100 x 50 mm"
    return table(title, ("nearest plane (mm off the face)", "rms error / rms field", "largest"), rows)


def arccos() -> str:
    """Eq 11, 12: relative error of a distance from the axis computed through the arc cosine of z / r."""
    rows = []
    for share in (1e-3, 1e-6):
        cells = [f"{share:g}"]
        for kind in (np.float64, np.float32):
            rho, z = (kind(v) for v in (0.05 * share, 0.05))
            r = np.sqrt(rho * rho + z * z)
            cells.append(f"{100 * abs(float(r * np.sin(np.arccos(z / r))) / float(rho) - 1.0):.2g} %")
        rows.append(cells)
    return table("Eq 11, 12: error of rho by arccos", ("rho / z", "float64", "float32"), rows)


def zero_start() -> str:
    """Table 8: fminsearch's first step, 0.00025 for a parameter at 0 and 5 % for others, beside steps as wide as the prior."""
    rig = load_rig(ROOT / "configs/paper_simulation.yaml").with_values(TRUTH)
    readings = observations_of(
        load_plan(ROOT / "configs/plans/paper_grid.yaml", rig), rig, np.random.default_rng(0)
    ).calibration
    truth = {**TRUTH, **{f"coil1.world_from_coil0.{key}": value for key, value in TILTED.items()}}
    field_T = torch.from_numpy(perfect_readings_T(truth, readings.motion["arm1"][:, :3].numpy(), CURRENT_A))
    names = (*NAMES, *(f"coil1.world_from_coil0.{key}" for key in TILTED))
    start = np.array([{**rig.nominal_values()}[name] for name in names])
    coordinates, model = Coordinates(rig), MeasurementModel.build(rig, readings)

    def cost_mT(numbers: np.ndarray) -> float:
        vector = coordinates.vector(dict(zip(names, torch.from_numpy(numbers), strict=True)))
        with torch.no_grad():
            error_T = model.predict(coordinates.values(vector)) - field_T
        return float(torch.nan_to_num(0.5e3 * error_T.square().sum(-1).mean().sqrt(), nan=1e9))

    steps = {
        "as fminsearch": np.where(start == 0.0, 0.00025, 0.05 * start),
        "as wide as the prior": np.array([rig.parameters[name].prior.sd for name in names]),
    }
    rows = []
    for words, step in steps.items():
        simplex = np.vstack((start, start + np.diag(step)))
        for most in (200, 1800):
            options = {
                "initial_simplex": simplex,
                "xatol": 1e-4,
                "fatol": 1e-4,
                "maxfev": most,
                "maxiter": most,
            }
            minimum = minimize(cost_mT, start, method="Nelder-Mead", options=options)
            rows.append(
                (
                    words,
                    f"{minimum.nfev}",
                    *(f"{1e3 * minimum.x[i]:.1f}" for i in (-2, -1)),
                    f"{1e3 * minimum.fun:.2g}",
                )
            )
    header = ("first steps", "evaluations", "tilt x (mrad), truth 20", "tilt y, truth -10", "RMSE left (uT)")
    return table("Rotations that start at exactly 0, winding at its truth, no noise", header, rows)


def study() -> str:
    """All tables of this file."""
    return "\n".join((small_modulus(), arccos(), literal_sum(), zero_start()))


def main() -> None:
    torch.set_num_threads(1)
    print(study())


if __name__ == "__main__":
    main()
