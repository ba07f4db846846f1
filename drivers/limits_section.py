"""Reads the limits in the `devices` section of a rig file; no device is touched here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.safety import ArmLimits, CurrentLimits
from drivers.settings import Settings


@dataclass(frozen=True, slots=True)
class RigLimits:
    """Limits of the devices of a rig, by their names.

    Attributes:
        currents: Limits of the coils.
        slews_A_per_s: Rates at which the supplies ramp.
        arms: Workspaces and speeds.
    """

    currents: dict[str, CurrentLimits] = field(default_factory=dict)
    slews_A_per_s: dict[str, float] = field(default_factory=dict)
    arms: dict[str, ArmLimits] = field(default_factory=dict)


def limits_of(section: Mapping[str, Any]) -> RigLimits:
    """Read the limits in a `devices` section.

    Args:
        section: Settings of each device, by its name.

    Raises:
        Refused: A limit is missing or impossible, or a coil with a highest temperature has no thermometer.
    """
    limits = RigLimits()
    with_thermometer = {target for mapping in section.values() for target in thermometer_inputs(mapping)}
    for name, mapping in section.items():
        settings = Settings(mapping, f"devices.{name}")
        if "supply" in settings:
            limits.currents[name] = current_limits(settings)
            if limits.currents[name].highest_temperature_K is not None and name not in with_thermometer:
                settings.refuse(
                    "highest_temperature_C",
                    f"must have a thermometer with an input for {name}; there is none",
                )
            limits.slews_A_per_s[name] = settings.quantity("ramp", "slew", limits.currents[name].slew_A_per_s)
        elif "arm" in settings:
            limits.arms[name] = arm_limits(settings)
    return limits


def thermometer_inputs(mapping: Any) -> Mapping[str, Any]:
    """Inputs of a thermometer by the coil or sensor that each measures; empty for any other device.

    Examples:
        >>> thermometer_inputs({"thermometer": "lakeshore_224", "inputs": {"coil1": "A"}}), thermometer_inputs({"supply": "scpi"})
        ({'coil1': 'A'}, {})
    """
    inputs = mapping.get("inputs", {}) if isinstance(mapping, Mapping) and "thermometer" in mapping else {}
    return inputs if isinstance(inputs, Mapping) else {}


def current_limits(settings: Settings) -> CurrentLimits:
    """Limits of one coil and its supply."""
    has_temperature = settings.has_quantity("highest_temperature", "temperature")
    numbers = {
        "lowest_A": settings.quantity("lowest", "current", 0.0),
        "highest_A": settings.quantity("highest", "current"),
        "slew_A_per_s": settings.quantity("slew", "slew"),
        "continuous_A": settings.quantity("continuous", "current"),
        "thermal_time_constant_s": settings.quantity("thermal_time_constant", "time"),
    }
    highest_K = settings.quantity("highest_temperature", "temperature") if has_temperature else None
    if settings.is_sound:
        with settings.noting(), settings.of_this():
            return CurrentLimits(**numbers, highest_temperature_K=highest_K)
    return CurrentLimits(0.0, 1.0, 1.0, 1.0, 1.0)  # stands for limits that could not be read


def arm_limits(settings: Settings) -> ArmLimits:
    """Limits of one arm."""
    low_x_m, low_y_m, low_z_m = settings.quantities("workspace_low", "length", 3)
    high_x_m, high_y_m, high_z_m = settings.quantities("workspace_high", "length", 3)
    speed_m_per_s = settings.quantity("highest_speed", "speed")
    return ArmLimits((low_x_m, low_y_m, low_z_m), (high_x_m, high_y_m, high_z_m), speed_m_per_s)
