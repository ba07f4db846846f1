"""`coilcal rig-simulator`: the instruments of a rig as processes behind real ports, for a rig without hardware."""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import torch
import yaml

from drivers.errors import DriverError
from drivers.interlock import sigterm_as_exception
from drivers.limits_section import limits_of
from drivers.protocols import FlangePose
from drivers.settings import Settings
from drivers.simulated.rig import SimulatedRig
from drivers.simulated.world import CoilCircuit
from estimator.calibration.result import write_text
from estimator.cli.options import hide_option, overwrite_option, seed_option, set_option, truth_option
from estimator.cli.output import explain_errors, named_number, refuse_existing
from estimator.cli.simulate import truth_of
from estimator.frames import vector_from_rotation
from estimator.geometry.motion import base_from_motion
from estimator.model.hide import full_names
from estimator.model.simulated_field import Flange, SimulatedField, simulated_rig
from estimator.rig.rig import MotionKind, Mover, Rig
from estimator.rig_files.devices import DEVICES, JOINT_ARMS, DeviceSettings
from estimator.rig_files.read import load_rig

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


@click.command("rig-simulator")
@click.argument("rig_path", metavar="RIG", type=click.Path(path_type=Path))
@hide_option
@truth_option("nominal")
@set_option
@seed_option
@click.option("--out", type=click.Path(path_type=Path), help="File for the devices section, for --devices.")
@overwrite_option
@explain_errors
def rig_simulator_command(
    rig_path: Path,
    hidden: tuple[str, ...],
    truth: str,
    assignments: tuple[str, ...],
    seed: int,
    out: Path | None,
    overwrite: bool,
) -> None:
    """Run a simulator for each device of RIG until Ctrl-C, and print the devices section that opens them.

    All share one world, whose field is that of the model. A rig without devices gets a Lake Shore F71 for each sensor, a Kepco BOP for
    each coil, an arm for each mover and a Lake Shore 224 that feels the coils. Coils warm up by their losses.
    """
    if out is not None:
        refuse_existing(out, overwrite)
    rig = load_rig(rig_path)
    values = truth_of(rig, truth, seed) | named_number(assignments, "--set")
    real = simulated_rig(rig, values, full_names(rig, named_number(hidden, "--hide")))
    section = rig.devices or default_devices(rig)
    with sigterm_as_exception(), _started(section, rig, real, seed) as running:
        text = yaml.safe_dump({DEVICES: running.section}, sort_keys=False, default_flow_style=None, width=120)
        if out is not None:
            write_text(out, text)
        click.echo(text)
        click.echo("coilcal: the rig runs; Ctrl-C ends it", err=True)
        sys.stdout.flush()
        try:
            _watch(running)
        except KeyboardInterrupt:
            click.echo("coilcal: the rig has ended", err=True)


def default_devices(rig: Rig) -> DeviceSettings:
    """Instruments for a rig that names none."""
    arms: dict[str, Mapping[str, Any]] = {}
    for mover in rig.movers:
        middle_m = _home(mover, MIDDLE_M)[0]
        arms[mover.name] = {
            "arm": JOINT_ARMS.get(mover.motion, "ur3e"),
            "workspace_low_mm": [round(1e3 * (x_m - HALF_M), 3) for x_m in middle_m],
            "workspace_high_mm": [round(1e3 * (x_m + HALF_M), 3) for x_m in middle_m],
            "highest_speed_mm_per_s": 250,
        }
    sensors, supplies = {s.name: SENSOR for s in rig.sensors}, {c.name: SUPPLY for c in rig.coils}
    felt = dict(zip(supplies, INPUTS, strict=False))
    warmth = {"warmth": {"thermometer": "lakeshore_224", "inputs": felt}} if felt else {}
    return {**sensors, **supplies, **arms, **warmth}


def _started(section: DeviceSettings, rig: Rig, real: Rig, seed: int) -> SimulatedRig:
    coils = tuple(name for name, settings in section.items() if "supply" in settings)
    homes = {
        name: _home(rig.mover(name), _middle_m(name, settings))
        for name, settings in section.items()
        if "arm" in settings
    }
    sensors = [name for name, settings in section.items() if "sensor" in settings]
    # Each arm needs an address of its own; those of this process collide with no other rig that runs.
    address = f"127.{1 + os.getpid() % 250}.{1 + os.getpid() // 250 % 250}.1"
    # Ctrl-C in a terminal reaches the simulators as well: they start deaf to it and end with this process.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return SimulatedRig(
            section,
            {
                name: SimulatedField(real, name, coils, homes, seed + number)
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
        signal.signal(signal.SIGINT, before)


def _middle_m(name: str, settings: Mapping[str, Any]) -> tuple[float, float, float]:
    """Middle of the workspace of an arm."""
    read = Settings(settings, f"{DEVICES}.{name}")
    low_m, high_m = (read.quantities(f"workspace_{end}", "length", 3) for end in ("low", "high"))
    x_m, y_m, z_m = (0.5 * (low + high) for low, high in zip(low_m, high_m, strict=True))
    return x_m, y_m, z_m


def _home(mover: Mover, middle_m: tuple[float, float, float]) -> Flange:
    """Where an arm stands at the start: a posture that folds no joint, or the middle of its workspace."""
    if mover.motion in JOINT_ARMS:
        there = base_from_motion(mover, torch.tensor([POSTURE_RAD], dtype=torch.float64))
        x_m, y_m, z_m = there.translation_m[0].tolist()
        x_rad, y_rad, z_rad = vector_from_rotation(there.rotation)[0].tolist()
        return (x_m, y_m, z_m), (x_rad, y_rad, z_rad)
    is_relative = mover.motion is MotionKind.DISPLACEMENT
    return middle_m, mover.reference_rotation_rad if is_relative else (0.0, 0.0, 0.0)


def _watch(running: SimulatedRig) -> None:
    """Wait; a simulator that ends by itself is a fault."""
    while True:
        time.sleep(WATCH_S)
        for name, simulator in running.simulators.items():
            if not simulator.is_running:
                raise DriverError(
                    f"{DEVICES}.{name}: its simulator must run; it has ended, see its error output"
                )
