"""What a user waits for: each command in a process of its own, beside a bare `python -c pass`; `make bench-commands` runs it.

Medians of repeats, smallest to largest in brackets: seconds until the first line of the result and until the end, seconds of the processor,
and peak memory. Cold is one run without bytecode and machine code of an earlier one; what the system holds of files stays. With `--beside`
another checkout takes turns, and its numbers stand below. With `--stages` the instant of each line on standard error is printed, too.
Commands with `--via local` are carried out by a `coilcal serve` that has its libraries; processor and memory are those of the caller.
"""

from __future__ import annotations

import argparse
import os
import selectors
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
PROGRAM = "from estimator.cli.main import main; main(prog_name='coilcal')"
RIG, PLAN = CONFIGS / "paper_simulation.yaml", CONFIGS / "plans/paper_grid.yaml"
TRUTH = CONFIGS / "truth/paper_simulation.json"
NOTHING = "python -c pass"
LOCAL = ["--via", "local"]
BYTES_PER_MB = 1e6


@dataclass(frozen=True)
class Run:
    """What one process took.

    Attributes:
        first_s: Until the first line of its result; until its end where it printed none.
        end_s: Until its end.
        processor_s: Of all its threads and children.
        memory_MB: At its peak, of the largest process.
        lines: Instants and words of what it told on standard error.
    """

    first_s: float
    end_s: float
    processor_s: float
    memory_MB: float
    lines: list[tuple[float, str]]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--only", nargs="*", help="names of commands, as the table has them")
    parser.add_argument("--beside", type=Path, help="another checkout, whose commands take turns with these")
    parser.add_argument("--stages", action="store_true")
    parser.add_argument("--no-cold", action="store_true")
    options = parser.parse_args()
    trees = [ROOT, *([options.beside.resolve()] if options.beside else [])]
    print(f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}; Python {sys.version.split()[0]}")
    print(f"{'command':22} {'result s':>21} {'end s':>21} {'processor s':>21} {'MB':>6} {'cold end s':>11}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        calls = prepared(folder)
        wanted = {name: call for name, call in calls.items() if not options.only or name in options.only}
        for command, arguments in wanted.items():
            measure(command, arguments, trees, folder, options)
        options.no_cold = True
        with serving(folder):
            for command, arguments in wanted.items():
                if command in ("check rig", "check readings", "predict", "calibrate"):
                    call = [*LOCAL, *arguments]
                    run(ROOT, call, os.environ, folder / "out")  # loads the libraries
                    measure(f"{command}, local", call, [ROOT], folder, options)


def prepared(folder: Path) -> dict[str, list[str]]:
    """Arguments of each command by its name, and what they read."""
    sessions = {name: folder / f"{name}.zarr" for name in ("session", "flawed")}
    csv, calibration, out = folder / "readings.csv", folder / "calibration", folder / "out"
    simulate = ["simulate", "--rig", RIG, "--plan", PLAN, "--truth", TRUTH, "--seed", 2]
    hidden = [*simulate, "--hide", "axis_gain.x=0.01", "--out", sessions["flawed"]]
    made = [
        [*simulate, "--out", sessions["session"], "--csv", csv],
        hidden,
        ["calibrate", sessions["session"], "--out", calibration, "--seed", 1],
        ["diagnose", sessions["flawed"], "--out", folder / "diagnosis", "--seed", 1, "--no-posterior"],
    ]
    for call in made:
        run(ROOT, [str(part) for part in call], os.environ)
    calls: dict[str, list[object]] = {
        NOTHING: [],
        "help": ["--help"],
        "help of batch": ["batch", "--help"],
        "explain": ["explain", "axis_gain"],
        "schema": ["schema", "rig"],
        "init": ["init", out, "--yes"],
        "check rig": ["check", RIG],
        "check plan": ["check", RIG, PLAN],
        "check readings": ["check", RIG, csv],
        "show rig": ["show", RIG],
        "show session": ["show", sessions["session"]],
        "show calibration": ["show", calibration],
        "show diagnosis": ["show", folder / "diagnosis"],
        "import": ["import", csv, "--rig", RIG, "--out", out],
        "simulate": [*simulate, "--out", out],
        "predict": ["predict", calibration, "--grid", "z_mm=0:80:9", "--current", "coil1=3", "--out", out],
        "export": ["export", calibration, "--to", "cpp", "--out", out],
        "report": ["report", calibration, "--out", out],
        "calibrate": ["calibrate", sessions["session"], "--out", out, "--seed", 1],
        "diagnose": ["diagnose", sessions["flawed"], "--out", out, "--seed", 1],
    }
    return {command: [str(part) for part in call] for command, call in calls.items()}


@contextmanager
def serving(folder: Path) -> Iterator[None]:
    """A `coilcal serve` that carries out commands."""
    os.environ["XDG_RUNTIME_DIR"] = str(folder)
    call = [sys.executable, "-c", PROGRAM, "serve", "--commands", "alone"]
    with subprocess.Popen(
        call, cwd=ROOT, env=variables(ROOT, os.environ), stdout=subprocess.DEVNULL
    ) as server:
        while not all((folder / "coilcal" / kind).exists() for kind in ("numpy", "torch")):
            time.sleep(0.1)
        try:
            yield
        finally:
            server.terminate()


def measure(
    command: str, arguments: list[str], trees: list[Path], folder: Path, options: argparse.Namespace
) -> None:
    """Print the rows of one command: a row a checkout, which take turns."""
    runs: dict[Path, list[Run]] = {tree: [] for tree in trees}
    for _ in range(options.repeats):
        for tree in trees:
            runs[tree].append(run(tree, arguments, os.environ, folder / "out"))
    for n, tree in enumerate(trees):
        cold = "" if options.no_cold else f"{cold_run(tree, arguments, folder).end_s:11.2f}"
        columns = [
            spread([getattr(each, key) for each in runs[tree]]) for key in ("first_s", "end_s", "processor_s")
        ]
        memory_MB = statistics.median(each.memory_MB for each in runs[tree])
        print(
            f"{command if n == 0 else '  beside':22} {' '.join(columns)} {memory_MB:6.0f} {cold}", flush=True
        )
        for instant_s, words in runs[tree][-1].lines if options.stages else ():
            print(f"    {instant_s:6.2f} s  {words}")


def cold_run(tree: Path, arguments: list[str], folder: Path) -> Run:
    """A run that finds no compiled code."""
    empty = folder / "cold"
    empty.mkdir()
    compiled = {"PYTHONPYCACHEPREFIX": str(empty / "bytecode"), "NUMBA_CACHE_DIR": str(empty / "numba")}
    try:
        return run(tree, arguments, {**os.environ, **compiled}, folder / "out")
    finally:
        shutil.rmtree(empty)


def run(
    tree: Path, arguments: list[str], environment: os._Environ[str] | dict[str, str], out: Path | None = None
) -> Run:
    """Run a command of a checkout; no arguments are a bare Python. `out` is taken away before.

    Raises:
        SystemExit: The command failed.
    """
    if out is not None:
        shutil.rmtree(out, ignore_errors=True)
        out.unlink(missing_ok=True)
    call = [sys.executable, "-c", *([PROGRAM, *arguments] if arguments else ["pass"])]
    begin_s = time.perf_counter()
    process = subprocess.Popen(
        call, cwd=tree, env=variables(tree, environment), stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    first_s, lines = followed(process, begin_s)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    end_s = time.perf_counter() - begin_s
    if process.returncode:
        sys.exit(f"{' '.join(arguments)} failed:\n" + "\n".join(words for _, words in lines))
    memory_MB = used.ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0) / BYTES_PER_MB
    return Run(first_s or end_s, end_s, used.ru_utime + used.ru_stime, memory_MB, lines)


def variables(tree: Path, environment: os._Environ[str] | dict[str, str]) -> dict[str, str]:
    """Variables with which commands of a checkout are called."""
    told = {**environment, "PYTHONPATH": str(tree)}
    told.pop("PYTHONDONTWRITEBYTECODE", None)  # or every run would compile the project anew
    return told


def followed(
    process: subprocess.Popen[bytes], begin_s: float
) -> tuple[float | None, list[tuple[float, str]]]:
    """Instant at which standard output began, and the lines on standard error with theirs."""
    first_s, lines = None, list[tuple[float, str]]()
    assert process.stdout is not None
    assert process.stderr is not None
    with selectors.DefaultSelector() as selector, process.stdout, process.stderr:
        for stream in (process.stdout, process.stderr):
            selector.register(stream, selectors.EVENT_READ)
        while selector.get_map():
            for key, _ in selector.select():
                piece = os.read(key.fd, 1 << 16)
                now_s = time.perf_counter() - begin_s
                if not piece:
                    selector.unregister(key.fileobj)
                elif key.fileobj is process.stderr:
                    lines += [(now_s, line) for line in piece.decode().splitlines()]
                elif first_s is None:
                    first_s = now_s
    return first_s, lines


def spread(values: list[float]) -> str:
    """Median, smallest and largest."""
    return f"{statistics.median(values):6.2f} ({min(values):5.2f} to {max(values):5.2f})"


if __name__ == "__main__":
    main()
