"""Table 2 and 3 of the paper: recover a simulated winding from noise-free readings.

Run `python scripts/recover_paper.py`; it prints start, truth and estimate, and the reduction of the RMSE. The readings come from the full
sum over 1200 loops, computed by magpylib (code of others), not from coilcal's own quadrature.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from estimator import load_plan, load_rig
from estimator.chain import Chain
from estimator.coordinates import Coordinates
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import point_estimate
from estimator.metrics import errors
from estimator.plan import observations_of
from tests.independent.readings import perfect_readings_T

TRUTH = {
    "coil1.radius_m": 0.051,
    "coil1.wire_radius_m": 0.49e-3,
    "coil1.axial_loops": 48.0,
    "coil1.radial_loops": 25.0,
}


def main() -> None:
    torch.set_num_threads(1)
    import numpy as np

    root = Path(__file__).resolve().parent.parent
    rig = load_rig(root / "configs/paper_noise_free.yaml")
    plan = load_plan(root / "configs/plans/paper_grid.yaml", rig)
    observations = observations_of(plan, rig, np.random.default_rng(0))
    readings_T = perfect_readings_T(
        TRUTH, observations.motion["arm1"][:, :3].numpy(), current_A=3.0, distance_m=0.04
    )
    observations = observations.with_field(torch.from_numpy(readings_T))
    calibration = observations.calibration
    coordinates = Coordinates(rig)
    posterior = LogPosterior(coordinates, Chain.build(rig, calibration), calibration)
    begin = time.perf_counter()
    estimate = point_estimate(posterior, calibration, seed=1)
    elapsed = time.perf_counter() - begin
    values = coordinates.values(estimate.vector)
    nominal = rig.nominal_values()
    print(f"{'parameter':22} {'start':>12} {'truth':>12} {'estimate':>22} {'relative error':>15}")
    for name, truth in TRUTH.items():
        found = float(values[name])
        print(f"{name:22} {nominal[name]:12.6g} {truth:12.6g} {found:22.16g} {found / truth - 1.0:15.2e}")
    for role, part in (("calibration", calibration), ("validation", observations.validation)):
        chain = Chain.build(rig, part, tolerance=1e-10)
        measured = part.field_sensor_T.numpy()
        start = {name: torch.tensor(value, dtype=torch.float64) for name, value in nominal.items()}
        before = errors(measured, chain.predict(start).numpy()).vector_T
        after = errors(measured, chain.predict(values).numpy()).vector_T
        print(
            f"{role}: RMSE {before * 1e3:.4f} mT -> {after * 1e9:.3g} nT, reduced by {100 * (1 - after / before):.7f} %"
        )
    counts = [round(float(values[f"coil1.{key}_loops"])) for key in ("axial", "radial")]
    print(f"loop counts: {counts[0]} x {counts[1]}; {elapsed:.1f} s, {estimate.n_evaluations} evaluations")


if __name__ == "__main__":
    main()
