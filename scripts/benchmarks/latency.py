"""Time to the field and gradient of a magnet at one pose, and at 1000, in C++ and Python, beside magpylib."""

from __future__ import annotations

import argparse
import re
import runpy
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import magpylib
import numpy as np
import torch

from estimator.calibration.result import Calibration
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig
from estimator.system.system import System

RIG = "configs/paper_simulation.yaml"
CURRENT_A = 3.0
N_POSES = 1000
LEAST_S = 0.3  # that a method is repeated for
STEP_M = 1e-5  # of differences, where a library has no gradient
GOAL_CPP_S, GOAL_PYTHON_S, GOAL_POSES_S = 20e-6, 100e-6, 2e-3
PROGRAM = """
#include "magnet.hpp"
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <vector>
using namespace NAMESPACE;
using Clock = std::chrono::steady_clock;
int main() {
  std::vector<std::array<double, 9>> rows(POSES);
  for (auto& row : rows)
    for (double& number : row)
      if (std::scanf("%lf", &number) != 1) return 1;
  Magnet magnet;
  double checked = 0.0;
  auto evaluate = [&](const std::array<double, 9>& row) {
    magnet.move(0, {row[3], row[4], row[5], row[6], row[7], row[8]});
    const auto at = magnet.field_and_gradient({row[0], row[1], row[2]}, {CURRENT});
    checked += at.field_T[0] + at.gradient_T_per_m[0][0];
  };
  std::vector<double> one, all;
  for (int repeat = 0; repeat < 30; ++repeat) {
    const auto begin = Clock::now();
    for (const auto& row : rows) {
      const auto before = Clock::now();
      evaluate(row);
      one.push_back(std::chrono::duration<double>(Clock::now() - before).count());
    }
    all.push_back(std::chrono::duration<double>(Clock::now() - begin).count());
  }
  for (auto* times : {&one, &all}) {
    std::sort(times->begin(), times->end());
    std::printf("%.9g %.9g %.9g ", (*times)[times->size() / 2], times->front(), times->back());
  }
  std::printf("%.17g\\n", checked / 30.0);
}
"""
Spread = list[float]  # median, smallest and largest time in seconds


def latency(options: argparse.Namespace) -> dict[str, Any]:
    """Seconds of each method for one pose and for 1000, field and gradient each; the pose changes from call to call."""
    rng = np.random.default_rng(options.seed)
    n = 40 if options.tiny else N_POSES
    points_m = rng.uniform([-0.03, -0.03, -0.01], [0.03, 0.03, 0.03], (n, 3))
    motions = np.concatenate((rng.uniform(-0.01, 0.01, (n, 3)), rng.uniform(-0.2, 0.2, (n, 3))), axis=1)
    model = nominal(load_rig(RIG))
    system = System({coil.name: model for coil in model.rig.coils})
    compiled = system.compiled()
    current_A = np.array([CURRENT_A])
    mover = compiled.movers[0]

    def machine_code(i: int) -> None:
        compiled.field_and_gradient(points_m[i : i + 1], current_A, motions[i : i + 1])

    def tensors(i: int) -> None:
        here = system.at(torch.from_numpy(points_m[i : i + 1]), {mover: torch.from_numpy(motions[i])})
        here.field_T(torch.from_numpy(current_A))
        here.gradient_T_per_m(torch.from_numpy(current_A))

    by_magpylib = magpylib_winding(model, points_m, motions)
    rows = {
        "coilcal, Python, System.compiled": {
            "one": seconds(machine_code, n, options),
            "all": seconds(
                lambda _: compiled.field_and_gradient(points_m, current_A, motions[:, None]), 1, options
            ),
        },
        "coilcal, Python, System.at (tensors)": {"one": seconds(tensors, n, options)},
        "magpylib Collection.getB, differences": {"one": seconds(by_magpylib, n, options)},
    }
    field_T, gradient = compiled.field_and_gradient(points_m, current_A, motions[:, None])
    checked = float((field_T[:, 0] + gradient[:, 0, 0]).sum())
    if shutil.which("g++"):
        rows = {"coilcal, C++ header, g++ -O2": in_cpp(model, points_m, motions, checked)} | rows
    return {"poses": n, "rows": rows}


def nominal(rig: Rig) -> Calibration:
    """A calibration whose best values are those of the rig file."""
    motion = {mover.name: torch.zeros(0, 6, dtype=torch.float64) for mover in rig.movers}
    readings = Observations.of(torch.zeros(0, len(rig.coils), dtype=torch.float64), motion)
    values = rig.nominal_values()
    draws = {parameter.name: np.full((1, 2), values[parameter.name]) for parameter in rig.free}
    return Calibration(rig, readings, values, draws, np.zeros((1, 2)), {})


def seconds(method: Callable[[int], None], n: int, options: argparse.Namespace) -> Spread:
    """Median, smallest and largest time of a call, after two that load and compile."""
    method(0)
    method(min(1, n - 1))
    times: list[float] = []
    while sum(times) < LEAST_S * options.repeats and len(times) < 3000:
        begin = time.perf_counter()
        method(len(times) % n)
        times.append(time.perf_counter() - begin)
        if options.tiny and len(times) > 2:
            break
    return [float(np.median(times)), min(times), max(times)]


def in_cpp(
    model: Calibration, points_m: np.ndarray, motions: np.ndarray, checked: float
) -> dict[str, Spread]:
    """The exported header, compiled; the sum of what it returns is that of Python."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        header = model.export("cpp", folder / "magnet.hpp").read_text(encoding="utf-8")
        namespace = re.findall(r"^namespace (coilcal_\w+)", header, re.MULTILINE)[0]
        program = PROGRAM.replace("NAMESPACE", namespace).replace("POSES", str(len(points_m)))
        (folder / "main.cpp").write_text(program.replace("CURRENT", repr(CURRENT_A)), encoding="utf-8")
        subprocess.run(["g++", "-std=c++17", "-O2", "main.cpp", "-o", "main"], cwd=folder, check=True)
        text = "\n".join(" ".join(map(repr, row)) for row in np.hstack((points_m, motions)).tolist())
        printed = subprocess.run(
            [folder / "main"], input=text, capture_output=True, text=True, check=True
        ).stdout
    *times, total = map(float, printed.split())
    assert abs(total - checked) < 1e-9 * abs(checked)
    return {"one": times[:3], "all": times[3:]}


def magpylib_winding(model: Calibration, points_m: np.ndarray, motions: np.ndarray) -> Callable[[int], None]:
    """Every loop of the winding as a circle, moved from call to call; the gradient by differences, which magpylib leaves to its user."""
    with tempfile.TemporaryDirectory() as name:
        module = runpy.run_path(str(model.export("magpylib", Path(name) / "magnet.py")))
    collection = module["magnet"]([CURRENT_A])
    steps_m = np.concatenate((np.zeros((1, 3)), STEP_M * np.eye(3), -STEP_M * np.eye(3)))

    def evaluate(i: int) -> None:  # rotations left out, which costs it nothing
        collection.position = motions[i, :3]
        field_T = magpylib.getB(collection, points_m[i] + steps_m)
        _ = (field_T[1:4] - field_T[4:]) / (2.0 * STEP_M)

    return evaluate


def show_latency(result: dict[str, Any]) -> None:
    """Print times and the goals that they are held against."""
    print("\nfield and gradient of the paper's simulated coil on a mover: median (smallest to largest)")
    print(f"{'':40} {'us for one pose':>32} {'ms for ' + str(result['poses']) + ' poses':>32}")
    for name, row in result["rows"].items():
        one, all_ = (
            f"{s[0] * factor:.4g} ({s[1] * factor:.3g} to {s[2] * factor:.3g})" if s else "-"
            for s, factor in ((row["one"], 1e6), (row.get("all"), 1e3))
        )
        print(f"{name:40} {one:>32} {all_:>32}")
    goals = {"coilcal, C++ header, g++ -O2": GOAL_CPP_S, "coilcal, Python, System.compiled": GOAL_PYTHON_S}
    for name, goal_s in goals.items():
        if name in result["rows"]:
            row = result["rows"][name]
            is_met = row["one"][0] <= goal_s and row["all"][0] <= GOAL_POSES_S
            print(
                f"goal, {name}: {goal_s * 1e6:.0f} us and {GOAL_POSES_S * 1e3:.0f} ms, {'met' if is_met else 'not met'}"
            )
