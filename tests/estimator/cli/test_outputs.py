"""What commands write: nothing of anybody else is touched, two writers do not mix, Ctrl-C and full disks leave nothing half."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from estimator.calibration.result import Calibration
from estimator.cli.options import OutputPath
from estimator.cli.output import CoilcalCommand, explained_errors
from estimator.store.session import SESSION
from estimator.store.staging import only_writer, staged, write_output
from tests.estimator.cli.conftest import run
from tests.estimator.store.interrupted import full_disk
from tests.program import PROGRAM, ROOT, launched

Tree = dict[str, tuple[Any, ...]]


def tree(folder: Path) -> Tree:
    """Everything in a folder: kind, content, target of a link, permissions."""
    found: Tree = {}
    for path in sorted(folder.rglob("*")):
        state = os.lstat(path)
        inside: Any = None
        if path.is_symlink():
            inside = path.readlink()
        elif path.is_file():
            inside = path.read_bytes()
        found[path.relative_to(folder).as_posix()] = (
            state.st_mode,
            state.st_ino if not path.is_dir() else 0,
            inside,
        )
    return found


def test_a_diagnosis_does_not_replace_the_folder_of_its_session(workspace, tmp_path):
    mine = tmp_path / "mine"
    shutil.copytree(workspace / "session.zarr", mine / "s.zarr")
    (mine / "diagnosis.json").write_text('{"verdict": "named"}')
    before = tree(tmp_path)
    result = run("diagnose", mine / "s.zarr", "--out", mine, "--overwrite")
    assert result.exit_code == 2
    assert (
        result.stderr
        == f"coilcal: output must not hold what is read; {mine} holds {mine / 's.zarr'}: take another\n"
    )
    result = run("diagnose", workspace / "session.zarr", "--out", mine, "--overwrite")
    assert result.exit_code == 2
    assert f"{mine} also holds s.zarr/current_A/c/0/0, s.zarr/current_A/zarr.json, " in result.stderr
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("calibrate s.zarr --out s.zarr/new", "output must stand outside of sessions and other stores; "),
        ("calibrate s.zarr --out s.zarr", "output must be another path than what is read; received s.zarr for both"),
        ("calibrate other.zarr --out s.zarr", "output must stand outside of sessions and other stores; "),
        ("calibrate s.zarr --out notes", "output must be a calibration, or a folder without the names of one; notes holds report.html"),
        ("calibrate s.zarr --out notes --overwrite", "output must be a calibration, or a folder without the names of one; "),
        ("batch s.zarr --out tables", "output must be a batch, or a folder without the names of one; tables holds summary.csv"),
        ("recalibrate --rig rig.yaml --inbox . --registry old", "output must be a registry, or a folder without the names of one; old holds current"),
        ("simulate --rig rig.yaml --plan plan.yaml --out /dev/null --overwrite", "output must be a file or folder; /dev/null is a device"),
        ("predict calibration --grid x_mm=0 --current coil1=1 --out /dev/null --overwrite", "output must be a file or folder; /dev/null is a device"),
        ("predict calibration --grid x_mm=0 --current coil1=1 --out link.csv --overwrite", "output must be a file or folder; link.csv is a link"),
        ("predict calibration --grid x_mm=0 --current coil1=1 --out calibration/summary.json --overwrite", "output must not replace a part of what is read; "),
        ("predict calibration --grid x_mm=0 --current coil1=1 --out s.zarr/field.csv", "output must stand outside of sessions and other stores; "),
        ("multipoles s.zarr --rig rig.yaml --out rig.yaml --overwrite", "output must be another path than what is read; received rig.yaml for both"),
        ("simulate --rig rig.yaml --plan plan.yaml --out s.zarr --csv s.zarr/f.csv --overwrite", "outputs must not be inside each other; "),
        ("simulate --rig rig.yaml --plan plan.yaml --out other.zarr --overwrite", "what is replaced must hold nothing but a session; other.zarr also holds notes.txt, which coilcal did not write"),
    ],
)  # fmt: skip
def test_what_is_not_the_programs_own_is_not_written_over(workspace, tmp_path, monkeypatch, command, message):
    shutil.copytree(workspace / "session.zarr", tmp_path / "s.zarr")
    shutil.copytree(workspace / "session.zarr", tmp_path / "other.zarr")
    (tmp_path / "other.zarr" / "notes.txt").write_text("mine")
    shutil.copytree(workspace / "calibration", tmp_path / "calibration")
    for name in ("rig.yaml", "plan.yaml"):
        shutil.copy(workspace / name, tmp_path / name)
    for name in ("notes/report.html", "tables/summary.csv", "old/current", "target"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("mine")
    (tmp_path / "link.csv").symlink_to("target")
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    result = run(*command.split())
    assert result.exit_code == 2
    assert result.stderr.startswith(f"coilcal: {message}")
    assert len(result.stderr.splitlines()) == 1
    assert tree(tmp_path) == before


def session_like(path: Path, words: str = "new") -> None:
    """Something with the layout of a session, made in no time."""
    path.mkdir()
    (path / "zarr.json").write_text(json.dumps({"kind": "coilcal session", "words": words}))
    (path / "time_s" / "c").mkdir(parents=True)
    (path / "time_s" / "zarr.json").write_text("{}")
    (path / "time_s" / "c" / "0").write_text("0")


@click.command(cls=CoilcalCommand)
@click.argument("source", type=click.Path(path_type=Path))
@click.option("--out", type=OutputPath(), required=True)
@click.option("--how", type=click.Choice(["file", "session", "fill"]))
@click.option("--overwrite", is_flag=True)
def write_command(source: Path, out: Path, how: str, overwrite: bool) -> None:
    """Write as commands do, without their calculations."""
    assert source is not None
    if how == "file":
        write_output(out, "new", overwrite)
    elif how == "session":
        with staged(out, overwrite, SESSION) as new:
            session_like(new)
    else:
        with only_writer(out):
            write_output(out / "result.json", "new", overwrite)


NAMES = st.sampled_from(
    ["out", "out.partial", "out.old", ".out.0123456789abcdef01234567.coilcal", "out/result.json", "out/zarr.json", "out/note", "in", "in/out", "out/in"]
)  # fmt: skip
KINDS = st.sampled_from(["file", "folder", "link", "dangling", "loop", "pipe", "socket", "session"])


def put(path: Path, kind: str) -> None:
    """Make something at a path, where nothing is in its way."""
    if os.path.lexists(path) or not path.parent.is_dir():
        return
    if kind == "file":
        path.write_text("mine")
    elif kind == "folder":
        path.mkdir()
    elif kind == "link":
        path.symlink_to(path.parent.parent / "precious")
    elif kind == "dangling":
        path.symlink_to("nowhere")
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(os.path.relpath(path))
    else:
        session_like(path, "mine")


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(NAMES, KINDS), max_size=8),
    st.sampled_from(["file", "session", "fill"]),
    st.booleans(),
    st.sampled_from(["in", "out", "out/in"]),
)
def test_among_any_files_only_the_output_itself_changes(
    tmp_path_factory: pytest.TempPathFactory,
    made: list[tuple[str, str]],
    how: str,
    overwrite: bool,
    source: str,
) -> None:
    place = tmp_path_factory.mktemp("any")
    (place / "precious").write_text("precious")
    here = place / "here"
    here.mkdir()
    before_folder = Path.cwd()
    os.chdir(here)  # the name of a socket must be short
    try:
        for name, kind in made:
            put(here / name, kind)
        before = tree(place)
        flags = ["--overwrite"] if overwrite else []
        result = CliRunner().invoke(write_command, [source, "--out", "out", "--how", how, *flags])
    finally:
        os.chdir(before_folder)
    assert isinstance(result.exception, SystemExit | None), result.exception
    after = tree(place)
    if result.exit_code:
        assert len(result.stderr.splitlines()) == 1, result.stderr
        assert after == before
        return
    output = "here/out/result.json" if how == "fill" else "here/out"
    assert output in after

    def others(found: Tree) -> Tree:
        return {
            name: state
            for name, state in found.items()
            if name != output and not name.startswith(f"{output}/")
        }

    added = set(others(after)) - set(others(before))
    assert added <= ({"here/out"} if how == "fill" else set())
    assert {name: after[name] for name in others(before)} == others(before)
    own = {
        "here/out/zarr.json",
        "here/out/time_s",
        "here/out/time_s/zarr.json",
        "here/out/time_s/c",
        "here/out/time_s/c/0",
    }
    lost = {name for name in before if name not in after}
    assert how == "session" or not lost
    assert lost <= own
    if output in before:  # what was replaced was asked for, and of the same kind
        assert overwrite
        assert before[output][2] == b"mine" or how == "session"


def interrupted(call: list[str], cwd: Path, is_time: Callable[[], bool]) -> tuple[str, str, int]:
    """Send Ctrl-C eight times to a command and all that it has started, as a terminal does."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    running = launched(*PROGRAM, *call, cwd=cwd, env=environment, start_new_session=True)
    while running.poll() is None and not is_time():
        time.sleep(0.01)
    for _ in range(8):
        if running.poll() is None:
            os.killpg(running.pid, signal.SIGINT)
        time.sleep(0.03)
    said, faults = running.communicate(timeout=120)
    return said, faults, running.returncode


def test_ctrl_c_ends_a_calibration_in_one_line_and_the_same_command_goes_on(workspace, tmp_path):
    limits = ["--walkers", "16", "--ess", "1e9", "--max-steps", "60"]
    call = ["calibrate", str(workspace / "session.zarr"), *limits, "--out"]
    chain = tmp_path / "out" / "chain.zarr" / "zarr.json"

    def steps() -> int:
        return int(json.loads(chain.read_bytes())["attributes"]["n_steps"]) if chain.exists() else 0

    said, faults, code = interrupted([*call, "out", "--quiet"], tmp_path, lambda: steps() > 0)
    assert (said, code) == ("", 130)
    assert faults.splitlines()[-1] == "coilcal: interrupted; the same command goes on"
    assert "Traceback" not in faults
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["chain.zarr"]
    before = steps()
    again = run(*call, tmp_path / "out")
    assert again.exit_code == 4
    assert steps() >= before
    Calibration.load(tmp_path / "out")


def test_a_disk_that_is_full_is_one_sentence_that_names_the_file(workspace, tmp_path):
    predict = ["predict", workspace / "calibration", "--grid", "x_mm=0", "--current", "coil1=1"]
    calls: list[tuple[Path, list[object]]] = [
        (tmp_path / "s.zarr", ["import", workspace / "readings.csv", "--rig", workspace / "rig.yaml", "--out", tmp_path / "s.zarr"]),
        (tmp_path / "f.csv", [*predict, "--out", tmp_path / "f.csv"]),
        (tmp_path / "m.hpp", ["export", workspace / "calibration", "--to", "cpp", "--out", tmp_path / "m.hpp"]),
    ]  # fmt: skip
    for out, call in calls:
        for n in (0, 1, 2, 3):
            with full_disk(n):
                result = run(*call)
            assert result.exit_code == 2
            words = f"output must be writable; {out} is not: No space left on device; the disk that holds it is full"
            assert result.stderr == f"coilcal: {words}: free some of it, or write to another\n"
            assert list(tmp_path.iterdir()) == []


def test_a_fault_of_the_system_without_a_file_is_not_said_of_none(capsys):
    with pytest.raises(SystemExit), explained_errors():
        raise OSError(28, "No space left on device")
    assert capsys.readouterr().err == (
        "coilcal: the system must allow what coilcal asks of it; it refused with: No space left on device\n"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_result_that_nobody_can_take_is_one_sentence(workspace):
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [*PROGRAM, "show", str(workspace / "session.zarr")], stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT, check=False
        )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr.startswith(
        "coilcal: output must be writable; standard output is not: No space left on device"
    )
    assert len(ended.stderr.splitlines()) == 1
