"""An instrument that fails in mid measurement: no current, a session that goes on, and one sentence that says what it was."""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml
from click.testing import Result

from drivers.protocols import FlangePose
from drivers.simulated.faults import Fault
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from estimator.cli.simulated_devices import default_devices
from estimator.rig_files.read import rig_from_text
from estimator.store.journal import JOURNAL
from estimator.store.session import is_growing, load_session
from tests.drivers.fields import along_z
from tests.drivers.rig import free_host
from tests.estimator.cli.conftest import run

PLAN = """\
schema_version: 1
name: to and fro
settle_s: 0.02
poses: {calibration: {arm1: {x_mm: {from: -20, to: 20, count: 3}}}}
currents_A: [{coil1: 1}, {coil1: -1}]
repeats: 4
"""
N_STOPS = 24


@contextmanager
def simulated(folder: Path, text: str, plan: str, circuit: CoilCircuit) -> Iterator[SimulatedRig]:
    """A rig that runs in this process, and its files."""
    section, home = default_devices(rig_from_text(text)), FlangePose((0.25, 0.0, 0.25), (0.0, 0.0, 0.0))
    with SimulatedRig(
        section, {"hall": along_z}, circuits=[circuit], homes=[home], first_host=free_host()
    ) as rig:
        (folder / "rig.yaml").write_text(text, encoding="utf-8")
        (folder / "plan.yaml").write_text(plan, encoding="utf-8")
        (folder / "devices.yaml").write_text(yaml.safe_dump({"devices": rig.section}), encoding="utf-8")
        yield rig


@pytest.fixture
def running(tmp_path: Path, rig_text: str) -> Iterator[SimulatedRig]:
    circuit = CoilCircuit(2.0, 0.01, kelvin_per_W=2.0, thermal_time_constant_s=5.0)
    with simulated(tmp_path, rig_text, PLAN, circuit) as rig:
        yield rig


def after_stops(out: Path, n_stops: int, act: Callable[[], None]) -> threading.Thread:
    """Do something once so many stops are in the journal."""

    def wait_and_act() -> None:
        deadline_s = time.monotonic() + 30.0
        while time.monotonic() < deadline_s:
            if (out / JOURNAL).exists() and (out / JOURNAL).read_bytes().count(b"\n") > n_stops:
                act()
                return
            time.sleep(0.01)

    thread = threading.Thread(target=wait_and_act)
    thread.start()
    return thread


def fails_after(rig: SimulatedRig, out: Path, n_stops: int, device: str, fault: Fault) -> threading.Thread:
    faults = rig.simulators[device].faults
    return after_stops(out, n_stops, lambda: setattr(faults, "fault", fault))


def acquire(folder: Path) -> Result:
    files = (folder / "rig.yaml", folder / "plan.yaml", "--devices", folder / "devices.yaml")
    return run("acquire", *files, "--out", folder / "session.zarr")


def sentence_of(result: Result) -> str:
    """What ended the run; on a busy computer a stop before may have been remarked on."""
    said = [line for line in result.stderr.splitlines() if line.startswith("coilcal: ")]
    (sentence,) = [line for line in said if not line.endswith("; it is marked so in the journal")]
    return sentence


@pytest.mark.parametrize(
    ("device", "fault", "word"),
    [
        pytest.param("hall", Fault.GARBAGE, "hall failed: ", marks=pytest.mark.slow),
        pytest.param("hall", Fault.STALL, "hall failed: an answer must end with", marks=pytest.mark.slow),
        ("warmth", Fault.PARTIAL, "the thermometer of coil1 failed: "),
        pytest.param("arm1", Fault.PROTECTIVE_STOP, "protective stop", marks=pytest.mark.slow),
        pytest.param("arm1", Fault.EMERGENCY_STOP, "emergency", marks=pytest.mark.slow),
    ],
)
def test_a_fault_ends_the_run_without_current_and_the_same_command_goes_on(
    running, tmp_path, device, fault, word
):
    out = tmp_path / "session.zarr"
    failing = fails_after(running, out, 3, device, fault)
    result = acquire(tmp_path)
    failing.join()
    assert result.exit_code == 5, result.stderr
    sentence = sentence_of(result)
    assert word in sentence
    assert sentence.endswith("; arms and currents were brought to rest")
    assert abs(running.world.snapshot().currents_A[0]) < 1e-3
    assert not running.world.is_moving(0)
    assert is_growing(out)
    n_before = len(load_session(out).observations)
    assert 3 <= n_before < N_STOPS
    if device in {"hall", "warmth"}:  # whose cable is back
        running.simulators[device].faults.fault = Fault.NONE
        result = acquire(tmp_path)
        assert result.exit_code == 0, result.stderr
        assert f"{n_before} of {N_STOPS} stops were visited before" in result.stderr
        assert len(load_session(out).observations) == N_STOPS


def test_a_coil_that_gets_too_hot_ends_the_run_and_the_same_command_goes_on_when_it_is_cool(
    running, tmp_path
):
    out = tmp_path / "session.zarr"
    section = {**running.section, "coil1": {**running.section["coil1"], "highest_temperature_C": 40}}
    (tmp_path / "devices.yaml").write_text(yaml.safe_dump({"devices": section}), encoding="utf-8")
    plan = tmp_path / "plan.yaml"
    plan.write_text(PLAN.replace("coil1: 1", "coil1: 3").replace("coil1: -1", "coil1: -3"), encoding="utf-8")
    result = acquire(tmp_path)
    assert result.exit_code == 5, result.stderr
    sentence = sentence_of(result)
    said = re.fullmatch(
        r"coilcal: coil1 failed: the coil is too hot: coil.temperature_C must be at most 40; it is (\d+\.\d\d); "
        r"arms and currents were brought to rest",
        sentence,
    )
    assert said is not None, sentence
    assert 40.0 < float(said[1]) < 46.0  # it gains 7 K a second, and is felt twice a second
    assert abs(running.world.snapshot().currents_A[0]) < 1e-3
    assert not running.world.is_moving(0)
    assert is_growing(out)
    before = load_session(out).observations
    assert 3 <= len(before) < N_STOPS
    assert float(before.temperature_C["coil1"].diff().min()) > 0.0
    assert float(before.temperature_C["coil1"].max()) <= 40.0
    time.sleep(6.0)
    assert acquire(tmp_path).exit_code in {0, 5}  # where stops take long, it is too hot again before the last
    after = load_session(out).observations
    assert len(after) > len(before)
    assert float(after.temperature_C["coil1"][len(before)]) < 35.0


@pytest.mark.parametrize(
    ("device", "fault", "is_off"),
    [
        ("coil1", Fault.DROP, False),
        pytest.param("coil1", Fault.MUTE, True, marks=pytest.mark.slow),
        pytest.param("arm1", Fault.MUTE, True, marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_reached_is_not_known_to_be_at_rest(running, tmp_path, device, fault, is_off):
    failing = fails_after(running, tmp_path / "session.zarr", 3, device, fault)
    result = acquire(tmp_path)
    failing.join()
    assert result.exit_code == 5
    sentence = sentence_of(result)
    assert f"{device} failed: " in sentence
    assert f"; {device} is not known to be at rest: " in sentence
    assert is_growing(tmp_path / "session.zarr")
    assert (abs(running.world.snapshot().currents_A[0]) < 1e-3) is is_off
