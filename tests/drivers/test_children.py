"""Child processes import what they run: not the main file of the program, and neither torch nor plots."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import textwrap
import threading
from pathlib import Path

import pytest

from drivers import supervised
from drivers.errors import DeadlineExceeded
from drivers.open import open_devices
from drivers.supervised import Supervised
from tests.drivers.rig import free_host
from tests.drivers.test_open import ARM, SENSOR, SUPPLY
from tests.program import PYTHON, finished

ROOT = Path(__file__).parents[2]
PROGRAM = """
import json
from pathlib import Path
with open("imported", "a") as file:
    file.write(__name__ + " ")
import matplotlib.pyplot  # as a notebook's script does, above everything and without a guard
import torch
from drivers.open import open_devices
from drivers.protocols import FlangePose
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from tests.drivers.fields import along_z

home = FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0))
circuits = [CoilCircuit(2.0, 0.0)]
section = json.loads(%r)
with SimulatedRig(section, {"hall": along_z}, circuits=circuits, homes=[home], first_host=%r) as rig:
    with open_devices(rig.section) as devices:
        devices.arms["arm1"].move_to(FlangePose((0.3, 0.0, 0.201), (0.0, 3.0, 0.0)), speed_m_per_s=0.05, timeout_s=60.0)
        children = Path("/proc/self/task").glob("*/children")
        pids = [pid for one in children for pid in one.read_text().split()]
        print(json.dumps({pid: Path(f"/proc/{pid}/maps").read_text() for pid in pids}))
"""


def test_no_child_imports_the_program_that_started_it_nor_a_large_library(tmp_path):
    warmth = {"thermometer": "lakeshore_224", "inputs": {"coil1": "A"}}
    section = json.dumps({"hall": SENSOR, "coil1": SUPPLY, "arm1": ARM, "warmth": warmth})
    (tmp_path / "program.py").write_text(PROGRAM % (section, free_host()), encoding="utf-8")
    environment = {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "PATH": "", "OMP_NUM_THREADS": "1"}
    done = finished(PYTHON, "program.py", cwd=tmp_path, env=environment, timeout=120)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "imported").read_text() == "__main__ "
    compiled = {
        pid: {name.partition(".")[0] for name in re.findall(r"/site-packages/([^/\s]+)", maps)}
        for pid, maps in json.loads(done.stdout).items()
    }
    # Four simulators, the supply's child and the arm's; a tracker of Python's own besides.
    assert len(compiled) >= 6
    assert {name for names in compiled.values() for name in names} <= {"rtde_control", "ur_rtde"}


def made_slowly(interrupt: threading.Event) -> None:
    interrupt.wait(90.0)


def test_a_supply_process_that_has_not_started_is_told_from_a_port_that_does_not_open(monkeypatch):
    monkeypatch.setattr(supervised, "_GRACE_S", 0.0)
    section = {"coil1": {**SUPPLY, "serial": "/dev/none", "longest_start_ms": 1}}
    with pytest.raises(
        DeadlineExceeded,
        match=r"the process of coil1 must have started within 0\.001 s; .*busy computer\?.*longest_start_s",
    ):
        open_devices(section)
    for longest_start_s in (4.0, 16.0, 64.0):  # a busy computer may need longer until the process is there
        with pytest.raises(DeadlineExceeded) as refusal:
            Supervised(made_slowly, "coil1", longest_start_s=longest_start_s)
        if "the process of" not in str(refusal.value):
            break
    assert f"coil1 must have opened within {longest_start_s:g} s; it has not" in str(refusal.value)


def test_a_child_that_the_main_file_defines_is_refused_before_it_starts():
    program = """
    from drivers.supervised import Supervised
    def make(interrupt):
        pass
    Supervised(make, "coil1", longest_start_s=10.0)
    """
    call = [sys.executable, "-c", textwrap.dedent(program)]
    done = subprocess.run(call, cwd=ROOT, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "Can't pickle <function make" in done.stderr
