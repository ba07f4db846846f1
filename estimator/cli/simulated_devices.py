"""Simulated instruments for `coilcal rig-simulator`: which a rig gets, how they start, and how they are watched."""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import torch

from drivers.errors import DriverError
from drivers.limits_section import limits_of
from drivers.protocols import FlangePose
from drivers.settings import Settings
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from estimator.geometry.motion import base_from_motion, pose_of
from estimator.model.simulated_field import Flange, SimulatedField
from estimator.rig.bodies import MotionKind, Mover
from estimator.rig.coordinates import nominal_tensors
from estimator.rig.rig import Rig
from estimator.rig_files.devices import DEVICES, JOINT_ARMS, DeviceSettings

CIRCUIT = CoilCircuit(resistance_ohm=2.0, inductance_H=0.01)
POSTURE_RAD = tuple(math.radians(angle) for angle in (0, -90, -90, 0, 90, 0))
MIDDLE_M, HALF_M = (0.25, 0.0, 0.25), 0.15
WATCH_S = 0.5

SENSOR: Mapping[str, Any] = {"sensor": "lakeshore_f71", "range_mT": 350, "own_temperature": True}
SUPPLY: Mapping[str, Any] = {
    "supply": "kepco_bop",
    "compliance_V": 20,
    "tolerance_mA": 5,
    "lowest_A": -5,
    "highest_A": 5,
    "slew_A_per_s": 20,
    "continuous_A": 5,
    "thermal_time_constant_min": 5,
    "highest_temperature_C": 80,
}
INPUTS = ("A", "B", *(f"C{i}" for i in range(1, 6)), *(f"D{i}" for i in range(1, 6)))


def default_devices(rig: Rig) -> DeviceSettings:
    """Devices section for a rig file that has none."""
    arms: dict[str, Mapping[str, Any]] = {}
    for mover in rig.movers:
        middle_m = _home(mover, _of_readings_m(rig, mover))[0]
        arms[mover.name] = {
            "arm": JOINT_ARMS.get(mover.motion, "ur3e"),
            "workspace_low_mm": [round(1e3 * (x_m - HALF_M), 3) for x_m in middle_m],
            "workspace_high_mm": [round(1e3 * (x_m + HALF_M), 3) for x_m in middle_m],
            "highest_speed_mm_per_s": 250,
        }
    sensors = {sensor.name: SENSOR for sensor in rig.sensors}
    supplies = {coil.name: SUPPLY for coil in rig.coils}
    inputs = dict(zip(supplies, INPUTS, strict=False))
    warmth = {"warmth": {"thermometer": "lakeshore_224", "inputs": inputs}} if inputs else {}
    return {**sensors, **supplies, **arms, **warmth}


def start_simulators(section: DeviceSettings, rig: Rig, true_rig: Rig, seed: int) -> SimulatedRig:
    """Start a process for each device of a section.

    Args:
        section: Devices to simulate.
        rig: Rig as its file describes it.
        true_rig: Rig whose field the sensors measure, with hidden causes.
        seed: Seed of the sensors' noise.
    """
    coils = tuple(name for name, settings in section.items() if "supply" in settings)
    homes = {
        name: _home(rig.mover(name), _middle_m(name, settings))
        for name, settings in section.items()
        if "arm" in settings
    }
    sensors = [name for name, settings in section.items() if "sensor" in settings]
    # Each arm needs an address of its own; addresses made from the process number collide with no other rig that runs.
    address = f"127.{1 + os.getpid() % 250}.{1 + os.getpid() // 250 % 250}.1"
    # Ctrl-C in a terminal reaches the simulators too: they start with it ignored, and end with this process.
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return SimulatedRig(
            section,
            {
                name: SimulatedField(true_rig, name, coils, homes, seed + number)
                for number, name in enumerate(sensors)
            },
            circuits=[
                replace(CIRCUIT, thermal_time_constant_s=limits.thermal_time_constant_s)
                for limits in limits_of(section).currents.values()
            ],
            homes=[FlangePose(*home) for home in homes.values()],
            first_host=address,
        )
    finally:
        signal.signal(signal.SIGINT, handler)


def watch(simulators: SimulatedRig) -> None:
    """Wait for Ctrl-C.

    Raises:
        DriverError: A simulator ended by itself.
    """
    while True:
        time.sleep(WATCH_S)
        for name, simulator in simulators.simulators.items():
            if not simulator.is_running:
                raise DriverError(
                    f"{DEVICES}.{name}: its simulator must run; it has ended, see its error output"
                )


def _middle_m(name: str, settings: Mapping[str, Any]) -> tuple[float, float, float]:
    """Middle of the workspace of an arm."""
    reader = Settings(settings, f"{DEVICES}.{name}")
    low_m, high_m = (reader.quantities(f"workspace_{end}", "length", 3) for end in ("low", "high"))
    x_m, y_m, z_m = (0.5 * (low + high) for low, high in zip(low_m, high_m, strict=True))
    return x_m, y_m, z_m


def _of_readings_m(rig: Rig, mover: Mover) -> tuple[float, float, float]:
    """Middle of a workspace: the origin of the room where a body stands still and poses are in the base; else any place."""
    stands_still = any(body.carried_by is None for body in (*rig.coils, *rig.sensors))
    if mover.motion is not MotionKind.POSE or not stands_still:
        return MIDDLE_M
    world_from_base = pose_of(f"{mover.name}.world_from_base", nominal_tensors(rig))
    return world_from_base.inverse().to_pose()[0]


def _home(mover: Mover, middle_m: tuple[float, float, float]) -> Flange:
    """Pose in which an arm starts: a posture that folds no joint, or the middle of its workspace."""
    if mover.table is not None:
        return base_from_motion(mover, torch.tensor([POSTURE_RAD], dtype=torch.float64)).to_pose()
    is_relative = mover.motion is MotionKind.DISPLACEMENT
    return middle_m, mover.reference_rotation_rad if is_relative else (0.0, 0.0, 0.0)
