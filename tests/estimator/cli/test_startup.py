"""Which large libraries each call loads: none for a page of help, and no command those of another."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest
import torch
from click.testing import CliRunner

from estimator.acquisition.pace import FEWEST_READINGS
from estimator.cli import acquire
from estimator.cli.main import main
from estimator.rig.rig import Rig
from estimator.store.growing import StopReadings, new_header
from estimator.store.journal import Journal
from estimator.store.session import Session, seal
from tests.once import once
from tests.program import PYTHON, ROOT, finished

LARGE = (
    *(
        "apscheduler",
        "arviz_stats",
        "dask",
        "distributed",
        "emcee",
        "jaxtyping",
        "jinja2",
        "matplotlib",
        "numba",
    ),
    *("numpy", "pandas", "rich", "scipy", "scipy.stats", "sympy", "torch", "xarray", "yaml", "zarr"),
)
RIG = {"jaxtyping", "numpy", "yaml"}
MODEL = RIG | {"numba", "scipy", "torch"}  # of scipy its name alone, which numba asks for
JACOBIANS = {"sympy"}  # torch.autograd.grad loads it where it is given weights
COMPLETION = {"_COILCAL_COMPLETE": "bash_complete", "COMP_WORDS": "coilcal cal", "COMP_CWORD": "1"}
LONGEST_HELP_S = 1.5  # of the processor: 0.2 s on a quiet computer, 5.7 s when help still loaded torch

LIGHT: dict[str, tuple[str, int, Mapping[str, str]]] = {
    "help": ("--help", 0, {}),
    "help of a command": ("predict --help", 0, {}),
    "version": ("--version", 0, {}),
    "no argument": ("predict", 2, {}),
    "unknown command": ("predikt", 2, {}),
    "unknown option": ("calibrate session.zarr --outt calibration", 2, {}),
    "value out of range": ("--threads 0 calibrate session.zarr --out calibration", 2, {}),
    "value that is no choice": ("import readings.csv --rig rig.yaml --out new.zarr --format docx", 2, {}),
    "completion": ("", 0, COMPLETION),
    "completion of options": ("", 0, {**COMPLETION, "COMP_WORDS": "coilcal predict --", "COMP_CWORD": "2"}),
}


def start(code: str, *arguments: object, variables: Mapping[str, str]) -> tuple[int, str, set[str], float]:
    """Run code in a process of its own: exit code, standard output, large libraries loaded and processor time in seconds."""
    at_exit = f"lambda: print(json.dumps([[n for n in {LARGE} if n in sys.modules], time.process_time()]), file=sys.stderr)"
    program = f"import atexit, json, sys, time; atexit.register({at_exit}); {code}"
    result = finished(PYTHON, "-c", program, *arguments, env={**os.environ, **variables})
    libraries, processor_s = json.loads(result.stderr.splitlines()[-1])
    return result.returncode, result.stdout, set(libraries), processor_s


def coilcal(
    *arguments: object, variables: Mapping[str, str] | None = None
) -> tuple[int, str, set[str], float]:
    """Run the command `coilcal` in a process of its own."""
    code = "from estimator.cli.main import main; main(prog_name='coilcal')"
    return start(code, *arguments, variables=variables or {})


@pytest.mark.parametrize("call", LIGHT)
def test_help_completion_and_refusals_load_no_large_library(call):
    arguments, exit_code, variables = LIGHT[call]
    returned, printed, libraries, processor_s = coilcal(*arguments.split(), variables=variables)
    assert (returned, libraries) == (exit_code, set())
    assert bool(printed) == (exit_code == 0)
    assert processor_s < LONGEST_HELP_S


def test_completion_offers_the_commands():
    assert coilcal(variables=COMPLETION)[1] == "plain,calibrate\n"


Ended = tuple[int, str, set[str]]
FORKS = f"""
import importlib, json, os, sys
for library in sys.argv[1:]:
    importlib.import_module(library)
from estimator.cli.main import main
for number, call in enumerate(json.load(sys.stdin)):
    child = os.fork()
    if child == 0:
        sys.argv = ["coilcal", *call]
        with open(str(number), "w") as sys.stdout:
            try:
                main(prog_name="coilcal")
            except SystemExit as ending:
                exit_code = ending.code
        with open(f"{{number}}.json", "w") as file:
            json.dump([exit_code or 0, [name for name in {LARGE} if name in sys.modules]], file)
        os._exit(0)
    os.waitpid(child, 0)
"""


@pytest.fixture(scope="module")
def ended(
    workspace: Path, small_rig: Rig, small_session: Session, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Ended]:
    """Commands that need what `MODEL` names: exit code, standard output, and large libraries that are loaded at the end."""

    def make(folder: Path) -> dict[str, Ended]:
        calls: dict[str, Sequence[object]] = {
            "live": [measured(small_rig, small_session, folder / "live.zarr"), "--no-refresh", "--json"],
            "design": [workspace / "session.zarr", "--shrink", "coil1.radius_m", "--readings", 1],
        }
        called = each_in_a_fork([[c, *rest] for c, rest in calls.items()], folder, MODEL)
        return dict(zip(calls, called, strict=True))

    return once(tmp_path_factory, "startup", make)


def each_in_a_fork(calls: Sequence[Sequence[object]], folder: Path, loaded: set[str]) -> list[Ended]:
    """Commands, each in a fork of one process that has loaded some libraries: a process for each would load them anew."""
    given = json.dumps([[str(part) for part in call] for call in calls])
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    call = [PYTHON, "-c", FORKS, *sorted(loaded)]
    subprocess.run(call, input=given, text=True, cwd=folder, env=environment, check=True)
    told = [json.loads((folder / f"{number}.json").read_text()) for number in range(len(calls))]
    return [(code, (folder / str(n)).read_text(), set(names)) for n, (code, names) in enumerate(told)]


def with_device(rig_text: str, path: Path) -> Path:
    devices = "devices:\n  hall: {sensor: lakeshore_460, range_mT: 30, serial: /dev/none}\n"
    path.write_text(rig_text + devices, encoding="utf-8")
    return path


def measured(rig: Rig, session: Session, path: Path) -> Path:
    """A session of three stops, as `coilcal acquire` leaves it."""
    readings = session.observations.calibration
    with Journal.create(path, new_header(rig, "a test", "plan", {})) as journal:
        for row in range(3):
            motion = {"arm1": readings.motion["arm1"][row].tolist()}
            field_T = {"hall": readings.field_sensor_T[row].tolist()}
            stop = StopReadings(float(row), readings.current_A[row].tolist(), motion, field_T, False, 0)
            journal.append(stop.entry())
    seal(path)
    return path


def test_what_reads_and_explains_loads_no_torch(workspace, rig_text, tmp_path):
    """Rigs and causes are declared without it, and nothing else reads an array."""
    rig, plan = workspace / "rig.yaml", workspace / "plan.yaml"
    diagnosis = tmp_path / "diagnosis"
    diagnosis.mkdir()
    told = {"verdict": "nothing_found", "causes": [], "next_measurement": [], "ended_early": None}
    (diagnosis / "diagnosis.json").write_text(json.dumps(told))
    calls: list[list[object]] = [
        ["explain"],
        ["explain", "axis_gain"],
        ["schema", "rig"],
        ["schema", "calibration"],
        ["check", rig],
        ["check", rig, plan],
        ["show", rig],
        ["show", plan],
        ["show", workspace / "readings.csv"],
        ["show", diagnosis],
        ["init", tmp_path / "new", "--yes"],
        ["devices", "check", with_device(rig_text, tmp_path / "rig.yaml")],
    ]
    ended = each_in_a_fork(calls, tmp_path, RIG)
    assert [code for code, *_ in ended] == [0] * (len(calls) - 1) + [5]
    assert all(printed for _, printed, _ in ended)
    # `init` fills templates by jinja2, which takes a tenth of a second.
    assert [
        (call, more)
        for call, (*_, loaded) in zip(calls, ended, strict=True)
        if (more := loaded - RIG - {"jinja2"})
    ] == []


def test_what_takes_no_derivative_computes_on_numpy(workspace, tmp_path):
    """Neither torch nor numba, each of which takes longer to load than all the rest."""
    rig, plan, csv = (workspace / name for name in ("rig.yaml", "plan.yaml", "readings.csv"))
    calibration, session = workspace / "calibration", workspace / "session.zarr"
    calls: list[list[object]] = [
        ["check", rig, csv],
        ["import", csv, "--rig", rig, "--out", tmp_path / "imported.zarr"],
        ["show", session],
        ["show", calibration],
        [
            *("simulate", "--rig", rig, "--plan", plan, "--truth", "nominal", "--hide", "axis_gain.x=0.01"),
            *("--out", tmp_path / "new.zarr"),
        ],
        [
            "predict",
            calibration,
            "--grid",
            "z_mm=10",
            "--current",
            "coil1=2",
            "--out",
            tmp_path / "field.csv",
        ],
        ["export", calibration, "--to", "cpp", "--out", tmp_path / "coil.hpp"],
    ]
    ended = each_in_a_fork(calls, tmp_path, RIG)
    assert [code for code, *_ in ended] == [0] * len(calls)
    assert all(printed for _, printed, _ in ended)
    assert [
        (call, more)
        for call, (*_, loaded) in zip(calls, ended, strict=True)
        if (more := loaded - RIG - {"zarr", "jinja2"})  # arrays, templates
    ] == []


def test_live_without_refresh_loads_neither_plots_nor_samplers(ended):
    exit_code, printed, libraries = ended["live"]
    assert (exit_code, json.loads(printed)["readings"]) == (0, 3)
    assert libraries == MODEL | JACOBIANS | {"rich"}


def test_design_loads_neither_plots_nor_samplers(ended):
    exit_code, _, libraries = ended["design"]
    assert (exit_code, libraries) == (0, MODEL | JACOBIANS | {"scipy.stats", "zarr"})  # draws of starts


def test_the_package_loads_a_public_name_when_it_is_used():
    assert start("import estimator; dir(estimator)", variables={})[2] == set()
    assert start("from estimator import InvalidInput", variables={})[2] == set()
    assert start("from estimator import load_rig", variables={})[2] == RIG
    effects = "from estimator import register_effect; from estimator.effects import EFFECTS"
    assert start(effects, variables={})[2] == RIG - {"yaml"}


def test_threads_are_set_where_a_command_runs(workspace, tmp_path, monkeypatch):
    threads: list[int] = []
    monkeypatch.setattr(torch, "set_num_threads", threads.append)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    call = ["--threads", "2", "report", str(workspace / "calibration"), "--out", str(tmp_path / "page.html")]
    assert CliRunner().invoke(main, [*call, "--help"]).exit_code == 0
    assert threads == []
    assert CliRunner().invoke(main, call).exit_code == 0
    assert threads == [2]


def test_fewest_readings_of_a_stop_are_those_of_the_acquisition():
    """The command states the number by itself: the acquisition needs torch."""
    assert acquire.FEWEST_READINGS == FEWEST_READINGS
