"""`--via local`: a command that another process carries out gives the same bytes, exit codes and endings, and nobody else reaches it."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from estimator.cli.local import COMMANDS
from estimator.cli.local_server import _bound
from estimator.cli.local_socket import is_own, opened_folder
from estimator.cli.main import main
from estimator.errors import InvalidInput
from tests.program import PROGRAM, ROOT, launched

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux only")
LONGEST_S = 120.0
LOADED = "import atexit, pathlib, sys; atexit.register(lambda: pathlib.Path('loaded').write_text(str('numpy' in sys.modules)));"
PREDICT = ["--grid", "z_mm=0:80:9", "--current", "coil1=2", "--out"]
ENDLESS = ["--ess", "1e9", "--max-steps", "1000000"]
HERE = "coilcal: the command runs here, since "


def environment(run: Path, root: Path = ROOT, **more: str) -> dict[str, str]:
    return {
        **os.environ,
        "XDG_RUNTIME_DIR": str(run),
        "PYTHONPATH": str(root),
        "OMP_NUM_THREADS": "1",
        **more,
    }


def until(is_so: Callable[[], object]) -> None:
    end_s = time.monotonic() + LONGEST_S
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def serving(run: Path, root: Path = ROOT) -> subprocess.Popen[str]:
    call = [*PROGRAM, "serve", "--commands", "alone"]
    server = launched(*call, env=environment(run, root), cwd=run)
    until(lambda: server.poll() is not None or len(list(run.glob("coilcal/*"))) == 4)
    return server


def end(server: subprocess.Popen[str]) -> None:
    server.terminate()
    server.communicate(timeout=LONGEST_S)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Folder of the sockets of a server that runs."""
    folder = tmp_path_factory.mktemp("run")
    server = serving(folder)
    yield folder
    end(server)
    assert server.returncode == 0
    assert {path.name for path in (folder / "coilcal").iterdir()} == {"numpy.lock", "torch.lock"}


def call(
    run: Path, cwd: Path, *arguments: object, root: Path = ROOT, **more: str
) -> subprocess.CompletedProcess[str]:
    program = [sys.executable, "-c", LOADED + PROGRAM[-1], *map(str, arguments)]
    return subprocess.run(
        program, cwd=cwd, env=environment(run, root, **more), capture_output=True, text=True, check=False
    )


def test_results_are_those_of_a_plain_command(workspace: Path, run: Path, tmp_path: Path) -> None:
    commands: dict[str, list[object]] = {
        "predict": [workspace / "calibration", *PREDICT, "out"],
        "calibrate": [workspace / "session.zarr", "--ess", 100, "--seed", 3, "--out", "out"],
    }
    for name, arguments in commands.items():
        ended = {}
        for via in ("here", "local"):
            cwd = tmp_path / name / via
            cwd.mkdir(parents=True)
            ended[via] = call(run, cwd, "--via", via, name, *arguments)
            assert (ended[via].returncode, (cwd / "loaded").read_text()) == (0, str(via == "here"))
        here, local = (tmp_path / name / via for via in ("here", "local"))
        assert ended["here"].stdout == ended["local"].stdout
        assert ended["here"].stderr == ended["local"].stderr
        for path in sorted(here.rglob("*")):
            if (
                path.is_file()
                and path.name not in ("loaded", "report.html")
                and "chain.zarr" not in path.parts
            ):
                assert path.read_bytes() == (local / path.relative_to(here)).read_bytes(), path
        assert (name != "calibrate") or (local / "out/report.html").is_file()


def test_folder_environment_and_umask_go_along(workspace: Path, run: Path, tmp_path: Path) -> None:
    before = os.umask(0o27)
    try:
        call(run, tmp_path, "predict", workspace / "calibration", *PREDICT, "field.csv", COILCAL_VIA="local")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "field.csv").stat().st_mode) == 0o640
    assert (tmp_path / "loaded").read_text() == "False"
    wrong = [workspace / "calibration", "--grid", "z_mm=0", "--current", "coil9=1", "--out", "new.csv"]
    refused = call(run, tmp_path, "--via", "local", "predict", *wrong)
    assert (refused.returncode, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)
    assert "coil9" in refused.stderr


@pytest.fixture
def endless(
    workspace: Path, run: Path, tmp_path: Path
) -> Iterator[tuple[subprocess.Popen[bytes], int, Path]]:
    """A command that samples: its caller, the process that waits for it, and what it tells."""
    arguments = ["calibrate", workspace / "session.zarr", "--out", "out", *ENDLESS]
    before, told = waiting(), tmp_path / "told"
    with told.open("wb") as file:
        caller = subprocess.Popen(
            [*PROGRAM, "--via", "local", *map(str, arguments)],
            cwd=tmp_path,
            env=environment(run),
            stdout=file,
            stderr=file,
        )
    until(lambda: "effective samples" in told.read_text())
    (waits,) = waiting() - before
    yield caller, waits, told
    if caller.poll() is None:
        caller.kill()
    caller.wait()
    until(lambda: "interrupted" in told.read_text())


def children(process: int) -> list[int]:
    return [int(word) for word in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def waiting() -> set[int]:
    """Processes that wait for a command on torch; the server is a child of this process."""
    grandchildren = [child for server in children(os.getpid()) for child in children(server)]
    return {fork for child in grandchildren for fork in children(child)}


def state(process: int) -> str:
    return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]


def test_ctrl_z_stops_and_ctrl_c_interrupts(endless: tuple[subprocess.Popen[bytes], int, Path]) -> None:
    caller, waits, told = endless
    (command,) = children(waits)
    caller.send_signal(signal.SIGTSTP)
    until(lambda: (state(caller.pid), state(command)) == ("T", "T"))
    caller.send_signal(signal.SIGCONT)
    until(lambda: "T" not in (state(caller.pid), state(command)))
    caller.send_signal(signal.SIGINT)
    assert caller.wait(LONGEST_S) == 130
    assert "coilcal: interrupted; the same command goes on\n" in told.read_text()


def test_sigterm_ends_both(endless: tuple[subprocess.Popen[bytes], int, Path]) -> None:
    caller, waits, told = endless
    caller.terminate()
    assert caller.wait(LONGEST_S) == -signal.SIGTERM
    until(lambda: not Path(f"/proc/{waits}").exists())
    told.write_text("interrupted")  # by the signal, without a word


def test_a_command_whose_caller_was_killed_is_interrupted(
    endless: tuple[subprocess.Popen[bytes], int, Path],
) -> None:
    caller, waits, told = endless
    caller.kill()
    until(lambda: not Path(f"/proc/{waits}").exists())
    assert "coilcal: interrupted; the same command goes on\n" in told.read_text()


def test_a_server_that_is_killed_ends_the_command_in_order(
    endless: tuple[subprocess.Popen[bytes], int, Path],
) -> None:
    caller, waits, told = endless
    (command,) = children(waits)
    os.kill(waits, signal.SIGKILL)
    assert caller.wait(LONGEST_S) == 130
    until(lambda: not Path(f"/proc/{command}").exists())
    assert "coilcal: coilcal serve ended before the command" in told.read_text()
    assert "coilcal: interrupted; the same command goes on\n" in told.read_text()


def test_without_a_server_the_command_runs_here(workspace: Path, tmp_path: Path) -> None:
    arguments = ["predict", workspace / "calibration", *PREDICT, "new.csv", "--overwrite"]
    nobody = f"{HERE}no coilcal serve of yours answers on this computer\n"
    asked = call(tmp_path, tmp_path, "--via", "local", *arguments)
    assert (asked.returncode, asked.stderr) == (0, nobody)
    assert call(tmp_path, tmp_path, *arguments, COILCAL_VIA="local").stderr == ""
    (tmp_path / "coilcal").mkdir(mode=0o755)
    (tmp_path / "coilcal").chmod(0o755)
    open_to_others = call(tmp_path, tmp_path, "--via", "local", *arguments)
    assert open_to_others.stderr.startswith(f"{HERE}folder must be yours and closed to all others")


def test_where_the_result_could_differ_the_command_runs_here(
    workspace: Path, run: Path, tmp_path: Path
) -> None:
    arguments = ["--via", "local", "predict", workspace / "calibration", *PREDICT, "new.csv", "--overwrite"]
    assert (
        call(run, tmp_path, *arguments, MKL_CBWR="AVX2").stderr
        == f"{HERE}coilcal serve has another MKL_CBWR\n"
    )
    assert call(run, tmp_path, "--threads", 2, *arguments).stderr == ""
    assert (tmp_path / "loaded").read_text() == "True"


def test_code_that_changed_is_not_run(workspace: Path, tmp_path: Path) -> None:
    copy, folder = tmp_path / "copy", tmp_path / "run"
    folder.mkdir()
    for package in ("coilcal", "drivers", "estimator"):
        shutil.copytree(ROOT / package, copy / package)
    server = serving(folder, copy)
    try:
        arguments = [
            "--via",
            "local",
            "predict",
            workspace / "calibration",
            *PREDICT,
            "new.csv",
            "--overwrite",
        ]
        other = call(folder, tmp_path, *arguments)
        assert other.stderr == f"{HERE}coilcal serve has another code, Python, PYTHONPATH\n"
        assert call(folder, tmp_path, *arguments, root=copy).stderr == ""
        (copy / "estimator/field/coil.py").touch()
        changed = call(folder, tmp_path, *arguments, root=copy)
        assert changed.stderr.startswith(f"{HERE}files of coilcal or of a library have changed")
    finally:
        end(server)


def test_one_server_of_a_user_carries_out_commands(run: Path) -> None:
    second = serving(run)
    _, told = second.communicate(timeout=LONGEST_S)
    assert (second.returncode, told) == (
        2,
        "coilcal: no other coilcal serve of yours may carry out commands; one does\n",
    )


def test_only_a_socket_of_the_user_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder, there = opened_folder(is_made=True), tmp_path / "coilcal"
    for kind, make in {
        "numpy": lambda path: path.write_text("mine"),
        "torch": lambda path: path.symlink_to("/"),
    }.items():
        make(there / kind)
        with pytest.raises(InvalidInput, match="must be a socket of yours"):
            _bound(folder, kind)
        (there / kind).unlink()
    for _ in range(2):  # the second time in the place of a socket that nobody answers at
        _bound(folder, "numpy").close()
    assert stat.S_IMODE(there.stat().st_mode) == 0o700
    os.close(folder)
    shutil.rmtree(there)
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    there.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="coilcal"):
        opened_folder()


def test_both_ends_ask_the_system_who_the_other_is(monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = socket.socketpair()
    with here, there:
        assert is_own(here)
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
        assert not is_own(here)


def test_what_measures_serves_or_asks_runs_here() -> None:
    assert set(main.commands) >= COMMANDS
    assert COMMANDS.isdisjoint(
        {"acquire", "live", "serve", "devices", "rig-simulator", "recalibrate", "batch"}
    )
