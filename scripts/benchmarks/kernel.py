"""Sum over loops and its first derivatives beside C by hand, and the start of a second process; `make bench-kernel` runs it.

The C code (`loops.c`) has the same formulas in vector instructions and is compiled here for this processor. Both take one core.
Repeats take turns, so that a busy moment of the machine affects all; each is the shortest of several calls.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from estimator.benchmarks.machine import processor
from estimator.field import kernel
from estimator.field.node_sum import Nodes, sum_over_nodes
from estimator.units import MU0_T_M_PER_A
from scripts.benchmarks.machine import use_cores

C_SOURCE = Path(__file__).with_name("loops.c")
N_POINTS, N_LOOPS = 2048, 64  # of the paper's coil, by its usual rule
# What a second process does before its first field, and then the field.
FIRST_FIELD = """
import time, torch
before_s = time.process_time()
from estimator.field.kernel import slopes_of_loops, sum_of_loops
imported_s = time.process_time()
one = torch.full((1, 1), 0.05, dtype=torch.float64)
sum_of_loops(torch.ones((1, 1, 3), dtype=torch.float64), one, one, one, 4)
slopes_of_loops(torch.ones((1, 1, 3), dtype=torch.float64), one, one, 4)
print(imported_s - before_s, time.process_time() - imported_s)
"""
Function = Callable[[], np.ndarray]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--calls", type=int, default=20, help="of which a repeat keeps the shortest")
    options = parser.parse_args()
    use_cores(1)
    torch.set_num_threads(1)
    print(f"{processor()}, load {os.getloadavg()[0]:.1f}, {N_POINTS} points, {N_LOOPS} loops, one core")
    with tempfile.TemporaryDirectory() as folder:
        libraries = by_hand(Path(folder))
        for steps in (3, 4, 6):
            show(steps, functions(libraries, steps), options.repeats, options.calls)
        show_start(Path(folder), options.repeats)


def by_hand(folder: Path) -> dict[str, ctypes.CDLL]:
    """C code for this processor, and once more without AVX-512 where it has that; empty without a compiler or such instructions."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        print("no C compiler (gcc or cc) is installed, so the yardstick in C is left out")
        return {}
    libraries: dict[str, ctypes.CDLL] = {}
    for name, flags in (("widest", []), ("avx2", ["-mno-avx512f"])):
        file = folder / f"{name}.so"
        command = [
            compiler,
            "-O3",
            "-march=native",
            *flags,
            "-shared",
            "-fPIC",
            "-o",
            str(file),
            str(C_SOURCE),
        ]
        made = subprocess.run(command, check=False, capture_output=True, text=True)
        if made.returncode:
            print(
                f"{compiler} does not compile {C_SOURCE.name} for this processor, so that yardstick is left out"
            )
            continue
        library = ctypes.CDLL(str(file))
        libraries.setdefault("C by hand, AVX-512" if library.lanes() == 8 else "C by hand, AVX2", library)
    return libraries


def functions(libraries: dict[str, ctypes.CDLL], steps: int) -> dict[str, Function]:
    """What is compared, by name; C comes first."""
    rng = np.random.default_rng(1)
    points_m = rng.uniform([-0.05, -0.05, 0.015], [0.05, 0.05, 0.065], (N_POINTS, 3))
    height_m, radius_m = -rng.uniform(0.0, 0.047, N_LOOPS), rng.uniform(0.027, 0.051, N_LOOPS)
    loops = [height_m, radius_m, rng.uniform(0.5, 1.5, N_LOOPS)]
    points, *nodes = (torch.from_numpy(array)[None] for array in (points_m, *loops))

    def c(library: ctypes.CDLL) -> np.ndarray:
        field = np.empty_like(points_m)
        addresses = [ctypes.c_void_p(array.ctypes.data) for array in (points_m, *loops, field)]
        library.sum_of_loops(
            addresses[0],
            ctypes.c_size_t(N_POINTS),
            *addresses[1:4],
            ctypes.c_size_t(N_LOOPS),
            ctypes.c_int(steps),
            ctypes.c_double(0.25 * MU0_T_M_PER_A),
            addresses[4],
        )
        return field

    watched = Nodes(*(value.clone().requires_grad_() for value in nodes))
    return {
        **{name: lambda library=library: c(library) for name, library in libraries.items()},
        "coilcal, value": lambda: kernel.sum_of_loops(points, *nodes, steps).numpy()[0],
        "coilcal, value and derivatives": lambda: kernel.slopes_of_loops(points, *nodes[:2], steps).numpy(),
        "torch, value with its graph": lambda: sum_over_nodes(points, watched, steps)[0].detach().numpy(),
    }


def show(steps: int, by_name: dict[str, Function], repeats: int, calls: int) -> None:
    """Nanoseconds for a loop at a point, beside the first function, and the largest difference from it."""
    results = {name: function() for name, function in by_name.items()}  # also translates
    times_ns: dict[str, list[float]] = {name: [] for name in by_name}
    for _ in range(repeats):
        for name, function in by_name.items():
            times_ns[name].append(min(seconds(function) for _ in range(calls)) / (N_POINTS * N_LOOPS) * 1e9)
    first = next(iter(by_name))
    reference = results[first]
    print(f"\n{steps + 1} steps of the mean: ns a loop and point, median of {repeats} (smallest to largest)")
    for name, ns in times_ns.items():
        ratio = statistics.median(a / b for a, b in zip(ns, times_ns[first], strict=True))
        difference = (
            f"{np.abs(results[name] - reference).max() / np.abs(reference).max():.0e}"
            if results[name].shape == reference.shape
            else ""
        )
        print(
            f"{name:32} {statistics.median(ns):6.2f} ({min(ns):.2f} to {max(ns):.2f})  {ratio:5.2f} x {difference}"
        )
    of_value = statistics.median(
        a / b
        for a, b in zip(times_ns["coilcal, value and derivatives"], times_ns["coilcal, value"], strict=True)
    )
    print(f"derivatives with the value take {of_value:.2f} times as long as the value alone")


def seconds(function: Function) -> float:
    begin_s = time.perf_counter()
    function()
    return time.perf_counter() - begin_s


def show_start(folder: Path, repeats: int) -> None:
    """Processor seconds to the first field in a new process: once with an empty cache on disk, then with what that left."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache")}
    runs = [
        [
            float(word)
            for word in subprocess.check_output([sys.executable, "-c", FIRST_FIELD], env=environment).split()
        ]
        for _ in range(1 + repeats)
    ]
    (_, translated_s), *later = runs
    imports_s, fields_s = zip(*later, strict=True)
    print(
        f"\na first process translates both sums for {translated_s:.1f} processor seconds and keeps them on disk"
    )
    for what, values_s in (("imports numba", imports_s), ("reads both sums from disk", fields_s)):
        print(
            f"a second one {what} in {statistics.median(values_s):.2f} processor seconds ({min(values_s):.2f} to {max(values_s):.2f})"
        )


if __name__ == "__main__":
    main()
