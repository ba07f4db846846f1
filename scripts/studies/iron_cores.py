"""Two coils with iron cores that the rig file does not tell of, and the hysteresis loop of a measured toroid.

The truth of the pair comes from cubes of iron (`tests.hidden.cored_pair`). `make iron-cores` runs it; the loop needs the folder named by
COILCAL_DATA and is left out without it.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import least_squares

from estimator import diagnose, load_rig
from estimator.diagnosis import effort
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.effects.attach import with_effect
from estimator.effects.stages import CoreMagnetisation
from estimator.effects.use import uses_of
from estimator.field.core import BANDS, HEIGHTS, share_of_heights
from estimator.field.saturation import played, polarisation_T
from estimator.model.cores import Cores
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.cored_pair import HALF_WIDTH_M, NAMES, CoredPair, Iron, write

UNSEEN_A = np.array([[3.5, -3.5], [6.0, 6.0], [6.0, -6.0], [-4.0, 7.0], [7.0, 2.0]])
RIVALS = ("iron_core", "core_saturation", "neighbour_coil", "current_gain")
CURVE_A = np.array([1.0, 2.5, 5.0, 7.5])
DRAWS = 200
DORTMUND = "dortmund-v308-axis-scans"
BRANCHES = ("hys_neu.txt", "hys_abf.txt", "hys_ans.txt")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--places", type=int, default=16, help="for each of 25 settings of the currents")
    parser.add_argument("--across", type=int, default=6, help="cubes across a core")
    parser.add_argument("--only", choices=("pair", "loop"), help="one of the two")
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.only != "loop":
        cored_pair(options.seed, options.places, options.across)
    data = os.environ.get("COILCAL_DATA")
    if options.only != "pair":
        if data:
            toroid(Path(data) / DORTMUND)
        else:
            print("loop: left out, for COILCAL_DATA is not set")


def cored_pair(seed: int, places: int, across: int) -> None:
    """Diagnose a pair whose rig file knows of no iron, and judge field, names and the curve of saturation."""
    rng = np.random.default_rng(seed)
    iron = Iron()
    pair = CoredPair((iron, iron), rng, across)
    at_m = rng.uniform(-HALF_WIDTH_M, HALF_WIDTH_M, (40, 3))
    truth_T = pair.field_T(UNSEEN_A, at_m)
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), pair, places, rng)
        rig = load_rig(Path(folder) / "rig.yaml")
        session = read_readings_csv(Path(folder) / "readings.csv", rig)
    begin = time.perf_counter()
    found = diagnose(
        session,
        seed=seed,
        on_stage=lambda words: print(f"  {time.perf_counter() - begin:4.0f} s {words}", flush=True),
    )
    record = found.to_json()
    print(f"pair: {record['verdict']}: {', '.join(cause['name'] for cause in record['causes'])}")
    for cause in record["causes"]:
        for key, known in cause["parameters"].items():
            print(f"    {cause['name']}.{key:13} {known['median']:9.5f} +- {known['sd']:.5f}")
    print(f"    truth: strength {iron.susceptibility / (20.0 + iron.susceptibility):.4f}, {iron}")
    fit, plain = found.fits.extended, found.fits.plain
    rivals = with_rivals(plain)
    for words, one in (
        ("with the cores", fit),
        ("rig as described", plain),
        (f"and {', '.join(RIVALS)}", rivals),
    ):
        error = relative_error(one, session.observations, at_m, truth_T)
        print(f"  both on, currents and places unseen, {words}: {100.0 * error:.2f} % of the rms field")
    saturation(fit, pair)


def with_rivals(plain: Fit) -> Fit:
    """What causes that each see one coil make of it, all of them at both coils."""
    rig = plain.rig
    for name in RIVALS:
        for coil in NAMES:
            rig = with_effect(rig, Cause(name, coil), plain.observations, {})
    rules = plain.posterior.model.rules
    return fit_rig(rig, plain.observations, plain.start_with(rig), rules, tolerance=effort.ROUGH_TOLERANCE)


def relative_error(fit: Fit, like: Observations, at_m: np.ndarray, truth_T: np.ndarray) -> float:
    """Rms error of the field over its rms, at every place and setting."""
    n_settings, n_places = truth_T.shape[:2]
    n = n_settings * n_places
    motion = np.zeros((n, 6))
    motion[:, :3] = np.tile(at_m, (n_settings, 1))
    current_A = torch.from_numpy(np.repeat(UNSEEN_A, n_places, axis=0))
    field_T = torch.full((n, 3), float(like.field_sensor_T.abs().max()), dtype=torch.float64)
    there = Observations.of(current_A, {"mapper": torch.from_numpy(motion)}, field_T)
    model = MeasurementModel.unruled(fit.rig, there).with_rules(fit.posterior.model.rules)
    with torch.no_grad():
        predicted_T = model.predict(fit.values).numpy().reshape(truth_T.shape)
    return float(np.sqrt(((predicted_T - truth_T) ** 2).sum() / (truth_T**2).sum()))


def saturation(fit: Fit, pair: CoredPair) -> None:
    """Moment of each core over the current of its coil, the other being off, with 90 % intervals by draws of the Laplace posterior."""
    if not uses_of(fit.rig, CoreMagnetisation):
        print("  no core was found")
        return
    root = torch.linalg.cholesky(fit.covariance)
    random = torch.Generator().manual_seed(0)
    draws = fit.vector + torch.randn(DRAWS, len(fit.vector), generator=random, dtype=torch.float64) @ root.T
    values = fit.posterior.coordinates.values(draws)
    sources = fit.posterior.model.sources
    rows = torch.zeros(1, dtype=torch.int64)
    poses = {coil.name: sources.world_from_body(coil, "coil", rows, values) for coil in fit.rig.wound}
    with torch.no_grad():
        cores = Cores.of(fit.rig, values, poses, sources.circumstances, False)
        for i, member in enumerate(cores.members):
            current_A = np.zeros((len(CURVE_A), 2))
            current_A[:, member.index] = CURVE_A
            true_A_m2 = pair.moments_A_m2(current_A)[member.index]
            polarisation = cores.polarisations_T(torch.from_numpy(current_A), None)[i][..., :HEIGHTS]
            mean_T = (polarisation * share_of_heights() / BANDS).sum(-1)
            volume_m3 = np.pi * member.core.radius_m**2 * member.core.length_m
            moment = mean_T * volume_m3[:, None] / (4e-7 * np.pi)
            low, middle, high = torch.quantile(
                moment, torch.tensor([0.05, 0.5, 0.95], dtype=torch.float64), dim=0
            )
            loss = 1.0 - (moment[:, -1] / CURVE_A[-1]) / (moment[:, 0] / CURVE_A[0])
            true_loss = 1.0 - (true_A_m2[-1] / CURVE_A[-1]) / (true_A_m2[0] / CURVE_A[0])
            print(f"  core of {member.coil.name}: moment in A m2 (90 %), truth")
            for k, current in enumerate(CURVE_A):
                where = inside(float(low[k]), true_A_m2[k], float(high[k]))
                print(
                    f"    {current:4.1f} A {middle[k]:7.4f} ({low[k]:.4f} to {high[k]:.4f}), {true_A_m2[k]:.4f} {where}"
                )
            least, likely, most = torch.quantile(
                100.0 * loss, torch.tensor([0.05, 0.5, 0.95], dtype=torch.float64)
            ).tolist()
            where = inside(least, 100.0 * true_loss, most)
            print(
                f"    lost to saturation from {CURVE_A[0]:g} to {CURVE_A[-1]:g} A: {likely:.2f} % ({least:.2f} to {most:.2f}), "
                f"truth {100.0 * true_loss:.2f} % {where}"
            )


def inside(low: float, value: float, high: float) -> str:
    return "inside" if low <= value <= high else "OUTSIDE"


def toroid(folder: Path) -> None:
    """The loop of a toroid with a gap, by a line, Froehlich's curve, and the curve with a play."""
    branches = [np.loadtxt(folder / name) for name in BRANCHES]
    current_A = torch.from_numpy(np.concatenate([branch[:, 0] for branch in branches]))
    field_T = 1e-3 * np.concatenate([branch[:, 1] for branch in branches])
    start = np.array([0.005, 0.9, 1.0, 0.3, 0.0])  # T/A, strength, saturation in T, play in A, offset in T

    def loop_T(numbers: np.ndarray, has_limit: bool) -> np.ndarray:
        per_A, strength, limit_T, play_A, offset_T = numbers
        seen_A = played(current_A, torch.tensor(play_A, dtype=torch.float64))
        of_iron = polarisation_T(
            (per_A * seen_A)[:, None],
            torch.zeros(1, 1, dtype=torch.float64),  # the gap's part cannot be told from the iron's softness
            torch.tensor([strength], dtype=torch.float64),
            torch.tensor([1.0 / limit_T if has_limit else 0.0], dtype=torch.float64),
        )
        return np.asarray(of_iron[:, 0].numpy() + offset_T)

    print(f"loop of a toroid, {len(field_T)} readings up to {1e3 * np.abs(field_T).max():.0f} mT")
    for words, free, has_limit in (
        ("a line", [0, 4], False),
        ("a line and a play", [0, 3, 4], False),
        ("Froehlich's curve", [0, 2, 4], True),
        ("Froehlich's curve and a play", [0, 2, 3, 4], True),
    ):

        def left_T(numbers: np.ndarray, free: list[int] = free, has_limit: bool = has_limit) -> np.ndarray:
            all_numbers = start.copy()
            all_numbers[3] = 0.0
            all_numbers[free] = numbers
            return loop_T(all_numbers, has_limit) - field_T

        best = least_squares(left_T, start[free], x_scale=np.abs(start[free]) + 1e-3)
        rms_T = float(np.sqrt(np.mean(best.fun**2)))
        numbers = ", ".join(f"{value:.4g}" for value in best.x)
        print(
            f"  {words}: rms {1e3 * rms_T:.1f} mT, largest {1e3 * np.abs(best.fun).max():.0f} mT ({numbers})"
        )


if __name__ == "__main__":
    main()
