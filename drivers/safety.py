"""Limits of a rig and the checks before each command; no device is touched here (see `drivers.guarded`)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import DeviceFault, Refused
from drivers.protocols import FlangePose, Vector
from drivers.readings import ICE_POINT_K


@dataclass(frozen=True, slots=True)
class CurrentLimits:
    """Limits of a coil and its supply.

    Attributes:
        lowest_A: Lowest current; zero for a unipolar supply.
        highest_A: Highest current.
        slew_A_per_s: Highest rate of change.
        continuous_A: Current that the coil bears for ever; more is allowed for a while (duty).
        thermal_time_constant_s: Of the coil; its temperature settles within a few of these.
        highest_temperature_K: Highest temperature at the coil's thermometer; None if it has none.
    """

    lowest_A: float
    highest_A: float
    slew_A_per_s: float
    continuous_A: float
    thermal_time_constant_s: float
    highest_temperature_K: float | None = None

    def __post_init__(self) -> None:
        for name in ("slew_A_per_s", "continuous_A", "thermal_time_constant_s"):
            if not getattr(self, name) > 0:
                raise Refused(f"limits.{name} must be > 0; received {getattr(self, name)}")
        if not self.lowest_A <= 0 <= self.highest_A:
            raise Refused(
                f"limits.lowest_A and highest_A must enclose 0; received {self.lowest_A:g} and {self.highest_A:g}"
            )


@dataclass(frozen=True, slots=True)
class ArmLimits:
    """Workspace and highest speed of an arm.

    Attributes:
        lowest_m: Corner of the workspace box, for the origin of the flange in the frame of the arm's base.
        highest_m: The opposite corner.
        highest_speed_m_per_s: Of the flange's origin.
    """

    lowest_m: Vector
    highest_m: Vector
    highest_speed_m_per_s: float


@dataclass(frozen=True, slots=True)
class CoilLoad:
    """Self-heating of a coil: mean square of its current, exponentially weighted with its thermal time constant.

    A coil with one heat capacity follows dT/dt = (R I^2 / C) - T / tau, where T is its temperature rise, so T is
    proportional to this mean.

    Attributes:
        time_s: When the load was computed.
        mean_square_A2: 0 for a cold coil, `continuous_A` squared for one at its limit.
    """

    time_s: float
    mean_square_A2: float

    def after(self, current_A: float, now_s: float, limits: CurrentLimits) -> CoilLoad:
        """The load at `now_s`, after a constant current has flowed since `time_s`.

        Examples:
            >>> limits = CurrentLimits(-5.0, 5.0, 10.0, continuous_A=3.0, thermal_time_constant_s=100.0)
            >>> CoilLoad(0.0, 0.0).after(5.0, 100.0, limits).mean_square_A2
            15.803
        """
        decay = math.exp(-max(0.0, now_s - self.time_s) / limits.thermal_time_constant_s)
        return CoilLoad(now_s, current_A**2 + (self.mean_square_A2 - current_A**2) * decay)

    def time_left_s(self, current_A: float, limits: CurrentLimits) -> float:
        """How long a current may flow before the coil reaches its limit; infinite up to `continuous_A`.

        Examples:
            >>> limits = CurrentLimits(-5.0, 5.0, 10.0, continuous_A=3.0, thermal_time_constant_s=100.0)
            >>> CoilLoad(0.0, 0.0).time_left_s(5.0, limits), CoilLoad(0.0, 0.0).time_left_s(2.0, limits)
            (44.6, inf)
        """
        excess_A2 = current_A**2 - limits.continuous_A**2
        if excess_A2 <= 0:
            return math.inf
        if self.mean_square_A2 >= limits.continuous_A**2:
            return 0.0
        return limits.thermal_time_constant_s * math.log((current_A**2 - self.mean_square_A2) / excess_A2)


def check_current(current_A: float, hold_s: float, load: CoilLoad, limits: CurrentLimits) -> None:
    """Refuse a current that the coil may not carry.

    Args:
        current_A: Current to request.
        hold_s: Time for which it must flow.
        load: Present load of the coil.
        limits: Limits of the coil.

    Raises:
        Refused: The current is beyond the limits, or would overheat the coil within `hold_s`.
    """
    if not limits.lowest_A <= current_A <= limits.highest_A:
        raise Refused(
            f"coil.current_A must be within {limits.lowest_A:g} and {limits.highest_A:g}; received {current_A:g}"
        )
    left_s = load.time_left_s(current_A, limits)
    if left_s < hold_s:
        raise Refused(
            f"coil.current_A beyond {limits.continuous_A:g} A must leave time to cool: {current_A:g} A may flow for {left_s:.1f} s now; "
            f"{hold_s:g} s are needed"
        )


def check_temperature(temperature_K: float, limits: CurrentLimits) -> None:
    """Check that a coil is not too hot, and that its thermometer gives a number.

    Raises:
        DeviceFault: The check failed. Unlike `Refused`, this trips the rig.

    Examples:
        >>> limits = CurrentLimits(-5.0, 5.0, 10.0, 3.0, 100.0, highest_temperature_K=353.15)
        >>> check_temperature(354.45, limits)
        Traceback (most recent call last):
        ...
        drivers.errors.DeviceFault: the coil is too hot: coil.temperature_C must be at most 80; it is 81.30
    """
    if limits.highest_temperature_K is None or temperature_K <= limits.highest_temperature_K:
        return
    if math.isnan(temperature_K):
        raise DeviceFault("the coil must have a thermometer that gives a number; it gives none")
    raise DeviceFault(
        f"the coil is too hot: coil.temperature_C must be at most {limits.highest_temperature_K - ICE_POINT_K:g}; "
        f"it is {temperature_K - ICE_POINT_K:.2f}"
    )


def check_motion(start: FlangePose, target: FlangePose, speed_m_per_s: float, limits: ArmLimits) -> None:
    """Refuse a straight motion that leaves the workspace or is too fast; a box that holds both ends holds the line.

    Raises:
        Refused: The speed, the start or the target is beyond the limits.

    Examples:
        >>> limits = ArmLimits((-0.1, -0.1, 0.0), (0.1, 0.1, 0.3), highest_speed_m_per_s=0.1)
        >>> here = FlangePose((0.0, 0.0, 0.1), (0.0, 0.0, 0.0))
        >>> check_motion(here, FlangePose((0.0, 0.0, 0.4), (0.0, 0.0, 0.0)), 0.05, limits)
        Traceback (most recent call last):
        ...
        drivers.errors.Refused: arm.target.z_m must be within 0 and 0.3; received 0.4
    """
    if not 0 < speed_m_per_s <= limits.highest_speed_m_per_s:
        raise Refused(
            f"arm.speed_m_per_s must be > 0 and at most {limits.highest_speed_m_per_s:g}; received {speed_m_per_s:g}"
        )
    for end, pose in (("target", target), ("start", start)):
        for axis, low_m, value_m, high_m in zip(
            "xyz", limits.lowest_m, pose.position_m, limits.highest_m, strict=True
        ):
            if not low_m <= value_m <= high_m:
                raise Refused(
                    f"arm.{end}.{axis}_m must be within {low_m:g} and {high_m:g}; received {value_m:g}"
                )
    if not all(math.isfinite(angle_rad) for angle_rad in target.rotation_vector_rad):
        raise Refused(f"arm.target.rotation_vector_rad must be finite; received {target.rotation_vector_rad}")
