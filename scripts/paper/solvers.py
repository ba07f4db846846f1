"""Section 4.3 of the paper (Table 2): which solver recovers a simulated winding, from 50 starts on the same noise-free readings.

Run `python -m scripts.paper.solvers`. Radius, wire radius, axial and radial loops are free, the pose is known. The starts are the paper's
and draws (seed 0) from the box that the rig file allows. SciPy's SLSQP stands for the paper's SQP, pymoo's genetic algorithm for its own,
and SciPy's differential evolution beside it. The table gives the units of the parameters, SI, prior widths or coilcal's natural
coordinates, which matter as much as the solver. A second table rounds the loop counts before the sum, as the paper's programme seems to
do (`whole_counts.py`). The readings come from magpylib's loops, not from coilcal's quadrature.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.optimize import differential_evolution, minimize
from torch import Tensor

from estimator import load_plan, load_rig
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.inference.nelder_mead import initial_simplex, minimise
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.plan import observations_of
from estimator.rig.coordinates import Coordinates
from scripts.paper import printed
from scripts.paper.tables import CURRENT_A, DISTANCE_M, NAMES, START, TRUTH, table
from tests.independent.readings import perfect_readings_T

ROOT = Path(__file__).resolve().parents[2]
GENERATIONS, POPULATION = 60, 40
RECOVERED = 1e-3  # largest relative error of the four parameters
PAPER = dict(zip(("SLSQP", "genetic", "Nelder-Mead"), printed.REDUCTION_PERCENT.values(), strict=True))


@dataclass(frozen=True)
class Ends:
    """End points of a solver, one row for each start.

    Attributes:
        values: Radius, wire radius, axial and radial loops.
        evaluations: Number of predictions of all readings; a Jacobian counts as one for each of its columns.
        seconds: Time of all starts together.
    """

    solver: str
    values: np.ndarray
    evaluations: np.ndarray
    seconds: float


class Problem:
    """The readings, and their root mean square error by the paper's definition (eq 2, 3) for any number of parameter sets.

    With `is_whole`, loop counts are rounded before the sum.
    """

    def __init__(self, is_whole: bool = False) -> None:
        self.is_whole = is_whole
        rig = load_rig(ROOT / "configs/paper_noise_free.yaml")
        plan = load_plan(ROOT / "configs/plans/paper_grid.yaml", rig)
        readings = observations_of(plan, rig, np.random.default_rng(0)).calibration
        positions_m = readings.motion["arm1"][:, :3].numpy()
        field_T = perfect_readings_T(TRUTH, positions_m, CURRENT_A, DISTANCE_M)
        self.readings = readings.with_field(torch.from_numpy(field_T))
        self.coordinates = Coordinates(rig)
        self.model = MeasurementModel.build(rig, self.readings)
        self.lower, self.upper = (end.numpy() for end in self.coordinates.bounds())
        self.width = np.array([rig.parameters[name].prior.sd for name in NAMES])
        self.n_evaluated = 0

    def starts(self, n: int) -> np.ndarray:
        """The paper's start, and draws from the box."""
        drawn = np.random.default_rng(0).uniform(self.lower, self.upper, (n - 1, len(NAMES)))
        return np.concatenate((np.array([[START[name] for name in NAMES]]), drawn))

    def error_T(self, values: Tensor) -> Tensor:
        """Half the rms length of the error vectors, at the nearest parameters inside the box."""
        inside = self.used(values.clamp(torch.from_numpy(self.lower), torch.from_numpy(self.upper)))
        self.n_evaluated += len(values)
        with torch.no_grad():
            predicted_T = self.model.predict(self.coordinates.values(self.vector(inside)))
        return 0.5 * (predicted_T - self.readings.field_sensor_T).square().sum(-1).mean(-1).sqrt()

    def used(self, values: Tensor) -> Tensor:
        """The parameters that the sum uses."""
        return torch.cat((values[..., :2], values[..., 2:].round()), dim=-1) if self.is_whole else values

    def vector(self, values: Tensor) -> Tensor:
        """Natural coordinates of radius, wire radius and loop counts."""
        return self.coordinates.vector(dict(zip(NAMES, values.unbind(-1), strict=True)))

    def values(self, vector: Tensor) -> Tensor:
        """Radius, wire radius and loop counts of natural coordinates."""
        resolved = self.coordinates.values(vector)
        return torch.stack([resolved[name] for name in NAMES], dim=-1)

    def walled_T(self, values: Tensor) -> Tensor:
        """`error_T` inside the box and +inf outside, for solvers without bounds."""
        is_inside = (values >= torch.from_numpy(self.lower)) & (values <= torch.from_numpy(self.upper))
        return torch.where(is_inside.all(-1), self.error_T(values), torch.inf)


def slsqp(problem: Problem, starts: np.ndarray, unit: np.ndarray, words: str) -> Ends:
    """Sequential quadratic programming with differences for derivatives."""

    def run(cost: Callable, start: np.ndarray, box: list, _: int) -> np.ndarray:
        options = {"ftol": 1e-9, "maxiter": 50}
        return minimize(cost, start, method="SLSQP", bounds=box, options=options).x

    return _start_by_start(f"SLSQP (SciPy), {words}", problem, starts, unit, run)


def evolution(problem: Problem, starts: np.ndarray) -> Ends:
    """Differential evolution; the start is one member of the first generation."""

    def run(cost: Callable, start: np.ndarray, box: list, number: int) -> np.ndarray:
        return differential_evolution(
            lambda columns: cost(columns.T), box, x0=start, popsize=POPULATION // len(start),
            maxiter=GENERATIONS, tol=0.0, polish=False, vectorized=True, updating="deferred", seed=number,
        ).x  # fmt: skip

    return _start_by_start("differential evolution (SciPy)", problem, starts, problem.width, run)


def genetic(problem: Problem, starts: np.ndarray) -> Ends:
    """The genetic algorithm of pymoo with its defaults: tournament, simulated binary crossover, polynomial mutation.

    The start is one member of the first generation.
    """
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.core.problem import Problem as Search
    from pymoo.optimize import minimize as evolve

    def run(cost: Callable, start: np.ndarray, box: list, number: int) -> np.ndarray:
        lower, upper = np.array(box).T

        class Field(Search):
            def _evaluate(self, x: np.ndarray, out: dict, *_: object, **__: object) -> None:
                out["F"] = cost(x)

        first = np.random.default_rng(number).uniform(lower, upper, (POPULATION, len(start)))
        first[0] = start
        search = GA(pop_size=POPULATION, sampling=first, eliminate_duplicates=True)
        return evolve(Field(n_var=len(start), n_obj=1, xl=lower, xu=upper), search, ("n_gen", GENERATIONS), seed=number).X  # fmt: skip

    return _start_by_start("genetic algorithm (pymoo)", problem, starts, problem.width, run)


def _start_by_start(
    solver: str, problem: Problem, starts: np.ndarray, unit: np.ndarray, run: Callable
) -> Ends:
    """Run a solver from each start, with parameters in multiples of `unit` and the error in mT."""
    box = list(zip(problem.lower / unit, problem.upper / unit, strict=True))

    def cost(scaled: np.ndarray) -> np.ndarray | float:
        error_T = problem.error_T(torch.from_numpy(np.atleast_2d(scaled) * unit))
        return 1e3 * error_T.numpy() if scaled.ndim == 2 else 1e3 * float(error_T)

    begin, values, counts = time.perf_counter(), [], []
    for number, start in enumerate(starts / unit):
        problem.n_evaluated = 0
        values.append(run(cost, start, box, number) * unit)
        counts.append(problem.n_evaluated)
    return Ends(solver, np.array(values), np.array(counts), time.perf_counter() - begin)


def nelder_mead(problem: Problem, starts: np.ndarray, is_natural: bool) -> Ends:
    """Nelder-Mead from all starts in one batch, in the paper's parameters or in natural coordinates."""
    begin = time.perf_counter()
    first, scale = torch.from_numpy(starts), torch.from_numpy(problem.width)
    if is_natural:
        first, scale = problem.vector(first), problem.coordinates.scale
    minimum = minimise(
        (lambda vector: problem.walled_T(problem.values(vector))) if is_natural else problem.walled_T,
        initial_simplex(first, -0.25 * scale),
        x_tolerance=1e-9 * scale,
        f_tolerance=1e-15,
        max_iterations=2000,
        n_restarts=1,
    )
    values = problem.values(minimum.points) if is_natural else minimum.points
    solver = f"Nelder-Mead, {'natural coordinates' if is_natural else 'prior widths'}"
    return Ends(solver, values.numpy(), minimum.n_evaluations.numpy(), time.perf_counter() - begin)


def from_many_starts(problem: Problem, starts: np.ndarray) -> Ends:
    """Levenberg-Marquardt from all starts in one batch, in natural coordinates with exact Jacobians."""
    begin = time.perf_counter()
    posterior = LogPosterior(problem.coordinates, problem.model, problem.readings)
    optimum = levenberg_marquardt(posterior, problem.vector(torch.from_numpy(starts)), max_iterations=200)
    evaluations = np.full(len(starts), optimum.n_iterations * (1 + len(NAMES)))  # at most
    values = problem.values(optimum.vector).numpy()
    return Ends("Levenberg-Marquardt, natural coordinates", values, evaluations, time.perf_counter() - begin)


def study(n_starts: int = 50) -> str:
    """Table 2: results from the paper's start and from all starts, with real counts and with rounded ones."""
    real, whole = Problem(), Problem(is_whole=True)
    starts = real.starts(n_starts)
    return "\n".join((
        _table(f"Table 2: solvers on noise-free readings at 5 x 5 x 5 points, {n_starts} starts", real, starts, (
            slsqp(real, starts, np.ones(len(NAMES)), "SI units"),
            slsqp(real, starts, real.width, "prior widths"),
            genetic(real, starts),
            evolution(real, starts),
            nelder_mead(real, starts, is_natural=False),
            nelder_mead(real, starts, is_natural=True),
            from_many_starts(real, starts),
        )),
        _table(f"Table 2 with loop counts rounded before the sum, {n_starts} starts", whole, starts, (
            slsqp(whole, starts, whole.width, "prior widths"),
            genetic(whole, starts),
            evolution(whole, starts),
            nelder_mead(whole, starts, is_natural=False),
        )),
    ))  # fmt: skip


def _table(title: str, problem: Problem, starts: np.ndarray, all_ends: Sequence[Ends]) -> str:
    truth = np.array([TRUTH[name] for name in NAMES])
    before_T = problem.error_T(torch.from_numpy(starts)).numpy()
    rows = []
    for ends in all_ends:
        reduction = 100.0 * (1.0 - problem.error_T(torch.from_numpy(ends.values)).numpy() / before_T)
        used = problem.used(torch.from_numpy(ends.values)).numpy()
        distance = np.abs(used / truth - 1.0).max(axis=1)
        paper = next(
            (f"{value:.4f} %" for words, value in PAPER.items() if ends.solver.startswith(words)), "not tried"
        )
        rows.append((
            ends.solver,
            paper,
            f"{reduction[0]:.4f} %",
            f"{distance[0]:.1e}",
            f"{np.median(reduction):.4f} %, {reduction.min():.4f} %",
            f"{np.median(distance):.1e}, {distance.max():.1e}",
            f"{(distance < RECOVERED).sum()} of {len(starts)}",
            f"{np.median(ends.evaluations):.0f}",
            f"{1e3 * ends.seconds / len(starts):.0f} ms",
        ))  # fmt: skip
    header = ("solver", "paper", "paper's start: RMSE less by", "distance to truth", "all starts: RMSE less by (median, least)",
              "distance (median, worst)", "recovered", "evaluations", "time per start")  # fmt: skip
    return table(title, header, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--starts", type=int, default=50)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(study(options.starts))


if __name__ == "__main__":
    main()
