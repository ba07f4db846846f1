"""The paper's simulation study (Tables 3 to 7, Figs 9 and 10): a known winding fitted at 5 x 5 x 5 points, judged at 20 x 20 x 20.

Run `python -m scripts.paper.simulation_study`. First as in the paper: readings without noise, pose known, four parameters free, estimated
as by MATLAB's fminsearch (first simplex 5 % of each value, tolerances 1e-4) and by coilcal, beside the printed numbers. Then as in a
laboratory: 20 uT of noise (seed 2) and a free pose. Last, the number of radial loops is fixed at wrong values and the others are fitted:
the readings determine fewer than four parameters. Readings come from magpylib's loops.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure

from estimator import load_plan, load_rig
from estimator.diagnosis.fitting import fit_rig
from estimator.inference.likelihood import LogPosterior
from estimator.inference.point_estimate import point_estimate
from estimator.model.bodies import winding_of
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.metrics import ErrorMetrics, error_metrics
from estimator.readings.observations import Observations
from estimator.readings.plan import observations_of
from estimator.reporting.plots import angular_deviation_map, relative_error_map
from estimator.reporting.plots.style import BLACK, BLUE, GREY, PURPLE, VERMILLION, figure
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from scripts.paper import printed, programme
from scripts.paper.tables import CURRENT_A, DISTANCE_M, FOUND, NAMES, START, TRUTH, table
from tests.independent.readings import perfect_readings_T

ROOT = Path(__file__).resolve().parents[2]
NOISE_T, SEED = 20e-6, 2
GRIDS_M = {
    "Tables 4, 5": 0.0,
    "Tables 6, 7": 0.015,
}  # nearest plane; the first fits best (errata), the second is ours


class Study:
    """One rig in the paper's workspace: readings to calibrate by and the true field to judge by."""

    def __init__(self, rig: Rig, truth: dict[str, float], distance_m: float | None, noise_T: float) -> None:
        plan = load_plan(ROOT / "configs/plans/paper_study.yaml", rig)
        observations = observations_of(plan, rig, np.random.default_rng(0))
        positions_m = observations.motion["arm1"][:, :3].numpy()
        true_T = perfect_readings_T(truth, positions_m, CURRENT_A, distance_m)
        self.rig = rig
        self.judged = observations.with_field(torch.from_numpy(true_T))
        noisy_T = true_T + noise_T * np.random.default_rng(SEED).normal(size=true_T.shape)
        self.calibration = observations.with_field(torch.from_numpy(noisy_T)).calibration
        self.coordinates = Coordinates(rig)
        self.start = {name: torch.tensor(v).double() for name, v in rig.nominal_values().items()}

    def estimate(self) -> dict[str, torch.Tensor]:
        """Nelder-Mead from 12 starts, then Levenberg-Marquardt."""
        model = MeasurementModel.build(self.rig, self.calibration)
        posterior = LogPosterior(self.coordinates, model, self.calibration)
        return self.coordinates.values(point_estimate(posterior, self.calibration, seed=1).vector)

    def fminsearch(self) -> dict[str, torch.Tensor]:
        """The paper's search: SciPy's Nelder-Mead with MATLAB's first simplex and tolerances."""
        model = MeasurementModel.build(self.rig, self.calibration)
        start = np.array([START[name] for name in NAMES])

        def values_of(numbers: np.ndarray) -> dict[str, torch.Tensor]:
            columns = dict(zip(NAMES, torch.from_numpy(numbers), strict=True))
            return self.coordinates.values(self.coordinates.vector(columns))

        def cost_mT(numbers: np.ndarray) -> float:
            with torch.no_grad():
                error_T = model.predict(values_of(numbers)) - self.calibration.field_sensor_T
            return 0.5e3 * float(error_T.square().sum(-1).mean().sqrt())

        return values_of(programme.fminsearch(cost_mT, start).x)

    def with_fixed_loops(self, radial_loops: float) -> dict[str, torch.Tensor]:
        """Best fit of the other parameters with a fixed, wrong number of radial loops."""
        rig = self.rig.with_values({**TRUTH, NAMES[3]: radial_loops}).with_fixed([NAMES[3]])
        return fit_rig(rig, self.calibration, {}, MeasurementModel.build(rig, self.calibration).rules).values

    def errors(self, values: dict[str, torch.Tensor], part: Observations) -> ErrorMetrics:
        """Errors of the predictions against the true field."""
        return error_metrics(part.field_sensor_T.numpy(), predicted_T(self.rig, part, values))

    def maps(self, values: dict[str, torch.Tensor], title: str) -> dict[str, Figure]:
        """Relative error and angle at the 20 x 20 x 20 points, in the frame of the coil."""
        part = self.judged.validation
        model = MeasurementModel.build(self.rig, part)
        rows = torch.arange(len(model.sensor))
        points_m = model.sensor_in_coil(self.rig.coils[0], rows, values)[0][model.pose_row].numpy()
        measured_T, predicted = part.field_sensor_T.numpy(), predicted_T(self.rig, part, values)
        winding = winding_of(self.rig, self.rig.coils[0], values)
        return {
            "relative_error": relative_error_map(points_m, measured_T, predicted, winding, title),
            "angle": angular_deviation_map(points_m, measured_T, predicted, winding, title),
        }


def predicted_T(rig: Rig, part: Observations, values: dict[str, torch.Tensor]) -> np.ndarray:
    with torch.no_grad():
        return MeasurementModel.build(rig, part, tolerance=1e-9).predict(values).numpy()


def recovered(columns: dict[str, dict], title: str) -> str:
    """Table 3: the four parameters, and the turns and length that the readings determine."""
    quantities = {
        "external radius (mm)": lambda radius, wire, axial, radial: 1e3 * radius,
        "wire radius (mm)": lambda radius, wire, axial, radial: 1e3 * wire,
        "axial loops": lambda radius, wire, axial, radial: axial,
        "radial loops": lambda radius, wire, axial, radial: radial,
        "turns": lambda radius, wire, axial, radial: axial * radial,
        "length (mm)": lambda radius, wire, axial, radial: 2e3 * wire * axial,
    }
    numbers = [[float(values[name]) for name in NAMES] for values in columns.values()]
    rows = [(words, *(f"{of(*four):.6g}" for four in numbers)) for words, of in quantities.items()]
    off = (max(abs(n / t - 1.0) for n, t in zip(four, TRUTH.values(), strict=True)) for four in numbers)
    rows.append(("largest error of the four", *(f"{error:.1e}" for error in off)))
    return table(title, ("quantity", *columns), rows)


def beside_the_printed(found: dict[str, torch.Tensor]) -> str:
    """Tables 4 to 7: the printed errors, those of the printed winding, and those of ours, with eq 2's factor and without."""
    radius_m, wire_m, axial, radial = (float(found[name]) for name in NAMES)
    mine = (1e3 * radius_m, 1e3 * wire_m, round(axial), round(radial))
    windings = {"start": printed.SIMULATED_START, "Table 3's end": printed.SIMULATED_FOUND, "coilcal": mine}
    rows = []
    for where, near_m in GRIDS_M.items():
        largest, rms = (line for line in printed.ERRORS if line.where == where)
        places_m = programme.box_m(20, near_m)
        true_T = CURRENT_A * programme.field_per_ampere(
            places_m, printed.SIMULATED_TRUTH, is_exact=near_m < 2e-3
        )
        for words, numbers in windings.items():
            field_T = CURRENT_A * programme.field_per_ampere(places_m, numbers, is_exact=near_m < 2e-3)
            metrics = error_metrics(true_T, field_T)
            of_paper = {
                "start": (rms.before_T, largest.before_T),
                "Table 3's end": (rms.after_T, largest.after_T),
            }
            cells = (f"{1e3 * float(value):.4g}" for value in of_paper.get(words, ()))
            sizes = (metrics.vector_T, metrics.paper_metric_T, metrics.max_T)
            rows.append((
                f"{where}, {words}",
                *(tuple(cells) or ("", "")),
                *(f"{1e3 * size_T:.3g}" for size_T in sizes),
                f"{100 * metrics.relative:.2g} %",
                f"{1e3 * metrics.angular_deviation_rad:.2g}",
            ))  # fmt: skip
    header = (
        "tables and winding",
        "paper: rms (mT)",
        "largest (mT)",
        "here: vector rms (mT)",
        "with eq 2's 1/2",
        "largest (mT)",
        "relative",
        "angle (mrad)",
    )
    title = "Tables 4 to 7: 20 x 20 x 20 places from the face on, and from 15 mm on; 3 A"
    return table(title, header, rows)


def error_table(title: str, study: Study, fits: dict[str, dict[str, torch.Tensor]]) -> str:
    """Error metrics of every fit on both grids."""
    rows = []
    for grid, part in (("5 x 5 x 5", study.judged.calibration), ("20 x 20 x 20", study.judged.validation)):
        for words, values in fits.items():
            metrics = study.errors(values, part)
            sizes = (
                f"{1e6 * size_T:.3g}" for size_T in (metrics.paper_metric_T, metrics.vector_T, metrics.max_T)
            )
            shares = (f"{100 * metrics.relative:.2g} %", f"{1e3 * metrics.angular_deviation_rad:.2g}")
            rows.append((f"{grid}, {words}", *sizes, *shares))
    sizes = ("paper's metric (uT)", "vector rms (uT)", "largest (uT)")
    return table(title, ("grid and model", *sizes, "relative", "angle (mrad)"), rows)


def valley(plain: Study) -> tuple[str, Figure]:
    """Residual after a fit with a wrong number of radial loops: below the noise of a sensor."""
    drawn = figure(8.0, 3.2, "one parameter held at a wrong value, the others fitted")
    left, right = drawn.subplots(1, 2)
    loops = TRUTH[NAMES[3]] + np.arange(-3.0, 4.0)
    fits = [{name: float(value) for name, value in plain.with_fixed_loops(n).items()} for n in loops]
    residual_uT = [
        1e6 * plain.errors({n: torch.tensor(v).double() for n, v in fit.items()}, plain.judged.calibration).vector_T
        for fit in fits
    ]  # fmt: skip
    left.plot(loops, residual_uT, color=BLACK, marker="o", ms=4)
    left.axhline(1e6 * NOISE_T * np.sqrt(3.0), color=GREY, lw=0.8, ls=":")
    left.annotate(
        "noise of a sensor with 20 µT",
        (25.0, 1.04e6 * NOISE_T * np.sqrt(3.0)),
        ha="center",
        va="bottom",
        fontsize=8,
    )
    left.set(xlabel="radial loops, held", ylabel="vector rms residual (µT)", ylim=(0.0, None))
    lines = {
        "axial loops": ([fit[NAMES[2]] / TRUTH[NAMES[2]] for fit in fits], VERMILLION, "s"),
        "wire radius": ([fit[NAMES[1]] / TRUTH[NAMES[1]] for fit in fits], PURPLE, "^"),
        "external radius": ([fit[NAMES[0]] / TRUTH[NAMES[0]] for fit in fits], BLUE, "v"),
        "turns": ([fit[NAMES[2]] * fit[NAMES[3]] / 1200.0 for fit in fits], BLACK, "o"),
    }
    for words, (ratio, colour, marker) in lines.items():
        right.plot(
            loops, 100.0 * (np.array(ratio) - 1.0), color=colour, marker=marker, ms=4, lw=1.0, label=words
        )
    right.axhline(0.0, color=GREY, lw=0.8)
    right.set(xlabel="radial loops, held", ylabel="off the truth (%)")
    right.legend(fontsize=8)
    rows = [
        (
            f"{n:.0f}",
            f"{r:.3g}",
            *(f"{round(100.0 * (ratio[i] - 1.0), 2) + 0.0:.2f} %" for ratio, *_ in lines.values()),
        )
        for i, (n, r) in enumerate(zip(loops, residual_uT, strict=True))
    ]
    header = ("radial loops held", "vector rms (uT)", *lines)
    return table("The valley behind Table 3, of 8.3 mT rms", header, rows), drawn


def study(out: Path) -> str:
    """Tables 3 to 7, and the figures as files."""
    out.mkdir(parents=True, exist_ok=True)
    perfect = Study(load_rig(ROOT / "configs/paper_noise_free.yaml"), TRUTH, DISTANCE_M, 0.0)
    as_paper = {"start": perfect.start, "fminsearch": perfect.fminsearch(), "coilcal": perfect.estimate()}
    truth = json.loads((ROOT / "configs/truth/paper_simulation.json").read_text(encoding="utf-8"))
    noisy = Study(load_rig(ROOT / "configs/paper_simulation.yaml"), truth, None, NOISE_T)
    in_laboratory = {"start, pose off": noisy.start, "coilcal, 20 uT and pose free": noisy.estimate()}
    for when, values in zip(("start", "calibrated"), in_laboratory.values(), strict=True):
        for kind, drawn in noisy.maps(values, f"{noisy.rig.name}, {when}").items():
            drawn.savefig(out / f"{kind}_{when}.png", dpi=90, bbox_inches="tight")
    trade, drawn = valley(perfect)
    drawn.savefig(out / "valley.png", dpi=90, bbox_inches="tight")
    fits = {
        words: fit for words, fit in {**as_paper, **in_laboratory}.items() if not words.startswith("start")
    }
    columns = {"truth": TRUTH, "start": START, "paper found": FOUND, **fits}
    return "\n".join((
        recovered(columns, "Table 3: what was recovered"),
        trade,
        beside_the_printed(as_paper["coilcal"]),
        error_table("Errors against the true field, without noise", perfect, as_paper),
        error_table("The same with 20 uT of noise and the pose free", noisy, in_laboratory),
    ))  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "out/paper")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(study(options.out))


if __name__ == "__main__":
    main()
