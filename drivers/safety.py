"""Limits of a rig and the checks before each command; no device is touched here (`drivers.guarded` does that)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import DeviceFault, Refused
from drivers.protocols import FlangePose, Vector
from drivers.readings import ICE_POINT_K


@dataclass(frozen=True, slots=True)
class CurrentLimits:
    """What a coil and its supply may be asked for.

    Attributes:
        lowest_A: Least current; zero where the supply is unipolar.
        highest_A: Greatest current.
        slew_A_per_s: Highest rate of change.
        continuous_A: Current that the coil bears for ever; more is allowed for a while (duty).
        thermal_time_constant_s: Of the coil; after a few of these its temperature has settled.
        highest_temperature_K: Where the coil has a thermometer; None without.
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
    """Where and how fast an arm may go.

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
    """How warm a coil is by its own current: its mean square with the weight of a thermal time constant.

    A coil as one heat capacity follows dT/dt = (R I^2 / C) - T / tau, so that T is in proportion to this mean.

    Attributes:
        time_s: When it was worked out.
        mean_square_A2: 0 for a cold coil, `continuous_A` squared for one at its limit.
    """

    time_s: float
    mean_square_A2: float

    def after(self, current_A: float, now_s: float, limits: CurrentLimits) -> CoilLoad:
        """The load when a current has flowed until now.

        Examples:
            >>> limits = CurrentLimits(-5.0, 5.0, 10.0, continuous_A=3.0, thermal_time_constant_s=100.0)
            >>> CoilLoad(0.0, 0.0).after(5.0, 100.0, limits).mean_square_A2
            15.803
        """
        left = math.exp(-max(0.0, now_s - self.time_s) / limits.thermal_time_constant_s)
        return CoilLoad(now_s, current_A**2 + (self.mean_square_A2 - current_A**2) * left)

    def time_left_s(self, current_A: float, limits: CurrentLimits) -> float:
        """How long a current may flow before the coil is at its limit; infinite for a continuous one.

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
        current_A: To be asked for.
        hold_s: How long it is to flow.
        load: Of the coil now.
        limits: Of the coil.

    Raises:
        Refused: It is beyond the limits, or would overheat the coil within `hold_s`.
    """
    if not limits.lowest_A <= current_A <= limits.highest_A:
        raise Refused(
            f"coil.current_A must be within {limits.lowest_A:g} and {limits.highest_A:g}; received {current_A:g}"
        )
    left_s = load.time_left_s(current_A, limits)
    if left_s < hold_s:
        raise Refused(
            f"coil.current_A beyond {limits.continuous_A:g} A must leave time to cool: {current_A:g} A may flow for {left_s:.1f} s now; "
            f"{hold_s:g} s are asked for"
        )


def check_temperature(temperature_K: float, limits: CurrentLimits) -> None:
    """Find fault with a coil that is too hot, or whose thermometer gives no number.

    Raises:
        DeviceFault: It is; other than a wish beyond a limit, this does not wait.

    Examples:
        >>> limits = CurrentLimits(-5.0, 5.0, 10.0, 3.0, 100.0, highest_temperature_K=353.15)
        >>> check_temperature(354.45, limits)
        Traceback (most recent call last):
        ...
        drivers.errors.DeviceFault: the coil is too hot: coil.temperature_C must be at most 80; it is 81.3
    """
    if limits.highest_temperature_K is None or temperature_K <= limits.highest_temperature_K:
        return
    if math.isnan(temperature_K):
        raise DeviceFault("the coil must have a thermometer that gives a number; it gives none")
    raise DeviceFault(
        f"the coil is too hot: coil.temperature_C must be at most {limits.highest_temperature_K - ICE_POINT_K:g}; "
        f"it is {temperature_K - ICE_POINT_K:.1f}"
    )


def check_motion(start: FlangePose, target: FlangePose, speed_m_per_s: float, limits: ArmLimits) -> None:
    """Refuse a straight line that leaves the workspace, or is too fast; a box holds a line where it holds both ends.

    Raises:
        Refused: It does.

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
    for place, pose in (("start", start), ("target", target)):
        for axis, low_m, value_m, high_m in zip(
            "xyz", limits.lowest_m, pose.position_m, limits.highest_m, strict=True
        ):
            if not low_m <= value_m <= high_m:
                raise Refused(
                    f"arm.{place}.{axis}_m must be within {low_m:g} and {high_m:g}; received {value_m:g}"
                )
    if not all(math.isfinite(angle_rad) for angle_rad in target.rotation_vector_rad):
        raise Refused(f"arm.target.rotation_vector_rad must be finite; received {target.rotation_vector_rad}")
