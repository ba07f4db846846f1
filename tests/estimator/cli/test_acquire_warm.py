"""A measurement that was interrupted with a warm coil goes on with a warm coil: what it has carried counts, and what it has lost."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import drivers.guarded
from drivers.safety import CoilLoad, CurrentLimits, check_current
from drivers.simulated.faults import Fault
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from estimator.store.journal import read_journal
from estimator.store.session import is_growing, load_session
from tests.estimator.cli.conftest import run
from tests.estimator.cli.test_acquire_faults import acquire, fails_after, simulated

CURRENT_A = 3.0
N_STOPS = 15
PLAN = f"""\
schema_version: 1
name: always on
settle_s: 0.02
poses: {{calibration: {{arm1: {{x_mm: {{from: -20, to: 20, count: 3}}}}}}}}
currents_A: [{{coil1: {CURRENT_A}}}]
repeats: 5
"""
TIME_CONSTANT_S = 10.0
"""Of the coil as the rig file knows it, and as it is."""

CIRCUIT = CoilCircuit(2.0, 0.01, kelvin_per_W=2.0, thermal_time_constant_s=TIME_CONSTANT_S)


@pytest.fixture
def interrupted(tmp_path: Path, rig_text: str) -> Iterator[SimulatedRig]:
    """A rig whose measurement, in `session.zarr`, has ended a moment ago because its sensor failed; the sensor is well again."""
    with simulated(tmp_path, rig_text, PLAN, CIRCUIT) as rig:
        write_devices(tmp_path, rig, continuous_A=5.0)
        failing = fails_after(rig, tmp_path / "session.zarr", 7, "hall", Fault.GARBAGE)
        result = acquire(tmp_path)
        failing.join()
        assert result.exit_code == 5, result.stderr
        rig.simulators["hall"].faults.fault = Fault.NONE
        yield rig


def write_devices(folder: Path, rig: SimulatedRig, continuous_A: float) -> None:
    coil = {key: value for key, value in rig.section["coil1"].items() if key != "thermal_time_constant_min"}
    coil |= {"thermal_time_constant_s": TIME_CONSTANT_S, "continuous_A": continuous_A}
    section = {**rig.section, "coil1": coil}
    (folder / "devices.yaml").write_text(yaml.safe_dump({"devices": section}), encoding="utf-8")


def load_of_coil_A2(rig: SimulatedRig) -> float:
    """What the coil has truly carried, by how warm it is: the mean square of its current with the weight of its time constant."""
    now = rig.world.snapshot()
    warmth_K = now.coil_temperatures_K[0] - now.room_temperature_K
    return warmth_K / CIRCUIT.kelvin_per_W / CIRCUIT.resistance_ohm


def test_its_guard_begins_with_what_the_coil_still_carries(interrupted, tmp_path, monkeypatch):
    looks: list[tuple[float, float]] = []

    def look(current_A: float, hold_s: float, load: CoilLoad, limits: CurrentLimits) -> None:
        looks.append((load.mean_square_A2, load_of_coil_A2(interrupted)))
        check_current(current_A, hold_s, load, limits)

    monkeypatch.setattr(drivers.guarded, "check_current", look)
    records = read_journal(tmp_path / "session.zarr")[1]
    result = acquire(tmp_path)
    assert result.exit_code == 0, result.stderr
    assert len(load_session(tmp_path / "session.zarr").observations) == N_STOPS
    counted_A2, real_A2 = looks[0]
    # The interrupted run may have gone on after its last stop for as long as its longest one.
    longest_s = max(record["end_s"] - record["begin_s"] for record in records)
    unknown_A2 = CURRENT_A**2 * (1.0 - math.exp(-longest_s / TIME_CONSTANT_S))
    assert real_A2 > 0.5
    assert 0.8 * real_A2 < counted_A2 < 1.2 * real_A2 + unknown_A2


def test_stops_that_are_left_are_refused_until_it_has_cooled(interrupted, tmp_path, monkeypatch):
    out = tmp_path / "session.zarr"
    n_before = len(read_journal(out)[1])
    left_s = duration_s(tmp_path) - duration_s(tmp_path, n_before)
    # With these limits a cold coil bears the stops that are left, with little to spare.
    continuous_A = CURRENT_A * math.sqrt(1.0 - math.exp(-1.02 * left_s / TIME_CONSTANT_S))
    write_devices(tmp_path, interrupted, continuous_A)
    before = interrupted.world.snapshot().base_from_flange
    result = acquire(tmp_path)
    assert result.exit_code == 2, result.stderr
    assert "of the plan, coil1: coil.current_A beyond" in result.stderr
    assert "must leave time to cool" in result.stderr
    assert interrupted.world.snapshot().base_from_flange == before
    assert is_growing(out)
    assert len(read_journal(out)[1]) == n_before
    now = time.time
    monkeypatch.setattr(time, "time", lambda: now() + 3600.0)
    assert planned(tmp_path)["stops"]


def planned(folder: Path) -> Any:
    """What a dry run shows."""
    files = (folder / "rig.yaml", folder / "plan.yaml", "--devices", folder / "devices.yaml")
    result = run("acquire", *files, "--out", folder / "session.zarr", "--dry-run", "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def duration_s(folder: Path, n_stops: int | None = None) -> float:
    """Of the first stops of the plan, or of all."""
    plan = planned(folder)
    return float(plan["duration_s"] if n_stops is None else plan["stops"][n_stops]["begin_s"])
