"""Reads what an entry of the `devices` section says, the whole of it before anything is opened.

Each function takes the settings of one device and returns what opens it, so that `coilcal check` can read without opening
(`faults_of` in `drivers.open`).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

from drivers.errors import DriverError
from drivers.guarded import GuardedArm, GuardedSource
from drivers.hall import lakeshore_460, lakeshore_f71, metrolab_thm1176, senis_3mh6
from drivers.interlock import Interlock
from drivers.limits_section import arm_limits, current_limits
from drivers.port_settings import connection_of, port_of
from drivers.protocols import CurrentSource, FieldSensor, RobotArm, TemperatureMonitor
from drivers.settings import Settings
from drivers.supervised import LONGEST_START_S
from drivers.supplies import korad_ka3005p, scpi
from drivers.supplies.commands import Rating, SupplyOpener
from drivers.supplies.ramped import RampedSource, longest_off_s
from drivers.supplies.supervised import SupervisedSource
from drivers.thermometers import lakeshore_224

SENSORS: Mapping[str, Callable[[Settings], Callable[[], FieldSensor]]] = {
    "lakeshore_f71": lakeshore_f71.opener,
    "lakeshore_460": lakeshore_460.opener,
    "senis_3mh6": senis_3mh6.opener,
    "metrolab_thm1176": metrolab_thm1176.opener,
}
"""What reads the settings of each model, and returns what opens it."""

SUPPLIES: Mapping[str, Callable[[Settings, Rating], SupplyOpener]] = {
    "kepco_bop": partial(scpi.opener, dialect=scpi.KEPCO_BOP),
    "korad_ka3005p": korad_ka3005p.opener,
    "scpi": partial(scpi.opener, dialect=scpi.GENERIC),
}
THERMOMETERS = ("lakeshore_224",)
ARMS = {model.lower(): model for model in ("UR3", "UR5", "UR10", "UR3e", "UR5e", "UR10e", "UR16e", "UR20")}


def sensor_of(settings: Settings) -> Callable[[], FieldSensor]:
    """What opens a magnetometer."""
    return SENSORS[settings.choice("sensor", tuple(SENSORS))](settings)


def monitor_of(settings: Settings) -> Callable[[], TemperatureMonitor]:
    """What opens an instrument that only measures temperatures."""
    settings.choice("thermometer", THERMOMETERS)
    inputs = settings.texts("inputs")
    with settings.noting(), settings.of_this():
        lakeshore_224.check_inputs(inputs)
    port = port_of(settings, lakeshore_224.SERIAL, lakeshore_224.TCP_PORT)
    return lambda: lakeshore_224.LakeShore224(port.open(), inputs)


def source_of(settings: Settings) -> Callable[[str, Interlock, Callable[[], float]], CurrentSource]:
    """What opens a supply, given its name, the interlock and a function that reads the temperature of its coil in kelvin."""
    opener = SUPPLIES[settings.choice("supply", tuple(SUPPLIES))]
    limits = current_limits(settings)
    tolerance_A = settings.quantity("tolerance", "current")
    compliance_V = settings.quantity("compliance", "voltage")
    slew_A_per_s = settings.quantity("ramp", "slew", limits.slew_A_per_s)
    start_s = settings.quantity("longest_start", "time", LONGEST_START_S)
    supply = opener(settings, Rating(limits.lowest_A, limits.highest_A, compliance_V, tolerance_A))
    make = partial(_make_source, supply, slew_A_per_s)

    def opened(name: str, interlock: Interlock, read_temperature_K: Callable[[], float]) -> CurrentSource:
        off_s = longest_off_s(max(-limits.lowest_A, limits.highest_A), slew_A_per_s)
        source: CurrentSource = (
            make(threading.Event())
            if supply.port.connection == "replay"
            else SupervisedSource(
                make, name, slew_A_per_s=slew_A_per_s, longest_off_s=off_s, longest_start_s=start_s
            )
        )
        if isinstance(source, SupervisedSource):
            interlock.add_condition(name, source.require_alive)
        try:
            return GuardedSource(
                source,
                limits,
                interlock,
                name=name,
                tolerance_A=tolerance_A,
                read_temperature_K=None if limits.highest_temperature_K is None else read_temperature_K,
            )
        except DriverError:
            source.close()
            raise

    return opened


def _make_source(supply: SupplyOpener, slew_A_per_s: float, interrupt: threading.Event) -> RampedSource:
    """Make a source; runs in its child process, which owns the port."""
    reopen = supply if supply.port.comes_back else None
    return RampedSource(supply(), slew_A_per_s=slew_A_per_s, interrupt=interrupt, reopen=reopen)


def arm_of(settings: Settings) -> Callable[[str, Interlock], RobotArm]:
    """What opens a robot arm, given its name and the interlock."""
    model = ARMS[settings.choice("arm", tuple(ARMS))]
    limits = arm_limits(settings)
    joint_limits_rad: Sequence[tuple[float, float]] | None = None
    if settings.has_quantity("joint_low", "angle") or settings.has_quantity("joint_high", "angle"):
        low_rad, high_rad = (settings.quantities(key, "angle", 6) for key in ("joint_low", "joint_high"))
        joint_limits_rad = tuple(zip(low_rad, high_rad, strict=True))
    start_s = settings.quantity("longest_start", "time", LONGEST_START_S)
    connection, address = connection_of(settings, ("host", "replay"))
    transcript = Path(settings.text("record")) if "record" in settings else None

    def opened(name: str, interlock: Interlock) -> RobotArm:
        # Imported here: only a rig with an arm needs the compiled ur_rtde.
        from drivers.robots.recorded import RecordingArm, ReplayedArm
        from drivers.robots.universal_robot import JOINT_LIMITS_RAD, UniversalRobot

        if connection == "replay":
            return GuardedArm(ReplayedArm(Path(address)), limits, interlock, name=name)
        allowed_rad = joint_limits_rad or JOINT_LIMITS_RAD
        arm: RobotArm = UniversalRobot(address, model, joint_limits_rad=allowed_rad, longest_start_s=start_s)
        if transcript is not None:
            try:
                arm = RecordingArm(arm, transcript, name=name)
            except OSError:
                arm.close()
                raise
        return GuardedArm(arm, limits, interlock, name=name)

    return opened
