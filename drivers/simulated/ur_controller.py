"""State of a simulated Universal Robots controller: registers, the control script of ur_rtde, safety, dashboard.

It does what the script that ur_rtde 1.6 uploads would do with its commands: a command number in input register 0 is carried out once;
output register 0 becomes 2 when that is done, and 1 when the number is back at zero. The joint angles are not those of a real arm: they
are the six numbers of the pose, so that readings of the joints agree with the inverse kinematics.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Sequence
from functools import cache

from drivers.protocols import FlangePose
from drivers.robots.rtde import Value
from drivers.rotation import angle_between_rad, distance_m
from drivers.simulated.world import World

_STOPPED, _PLAYING = 1, 2
_NORMAL_BIT, _PROTECTIVE_BIT, _EMERGENCY_BIT = 1 << 0, 1 << 2, 1 << 7
_POWER_ON_BIT, _PROGRAM_RUNNING_BIT = 1 << 0, 1 << 1
_ASYNC_RUNNING = 1 << 15
_LONGEST_CYCLE_S = 0.02
"""A real controller never pauses longer between two cycles; where this process did, that is no silence of its client."""
_FASTEST_ROTATION_RAD_PER_S = 1.0
_SHOULDER_M = 0.152
"""Height of the shoulder, from which the reach of an arm is measured."""

_KINDS = (
    (r"actual_joint_voltage", "VECTOR6D"),
    (r"actual_(momentum|.*voltage|robot_current|execution_time)|standard_analog_.*|payload", "DOUBLE"),
    (r"timestamp|.*_double_register_\d+|speed_scaling|target_speed_fraction", "DOUBLE"),
    (r".*_int_register_\d+|robot_mode|safety_mode", "INT32"),
    (r"runtime_state|.*_status_bits", "UINT32"),
    (r"actual_digital_.*_bits", "UINT64"),
    (r"joint_mode", "VECTOR6INT32"),
    (r"actual_tool_accelerometer|payload_(cog|inertia)", "VECTOR3D"),
    (r"(actual|target)_\w+|joint_\w+|ft_raw_wrench|external_force_torque", "VECTOR6D"),
)
"""Types of the variables that ur_rtde and this package request; the first matching pattern counts."""


@cache
def kind_of(name: str) -> str:
    """Type of a variable, as in the tables of the RTDE guide.

    Examples:
        >>> kind_of("actual_TCP_pose"), kind_of("output_int_register_2"), kind_of("actual_joint_voltage"), kind_of("wishes")
        ('VECTOR6D', 'INT32', 'VECTOR6D', 'NOT_FOUND')
    """
    return next((kind for pattern, kind in _KINDS if re.fullmatch(pattern, name)), "NOT_FOUND")


class UrController:
    """State of the controller; its server calls `tick` in every control cycle."""

    def __init__(
        self, world: World, arm: int, *, version: str, serial_number: str, reach_m: float = 0.5
    ) -> None:
        self._world, self._arm, self._reach_m = world, arm, reach_m
        self.version, self.serial_number = version, serial_number
        self.inputs: dict[str, Value] = {}
        self._outputs: dict[str, Value] = {"output_int_register_0": 0, "output_int_register_2": 0}
        self._start_s = time.monotonic()
        self._runtime_state = _STOPPED
        self._safety_bits = _NORMAL_BIT
        self._is_executing = False
        self._is_async = False
        self._n_operations = 0
        self._tcp: tuple[float, ...] = (0.0,) * 6
        self._watchdog_s, self._kicked_s = math.inf, 0.0
        self._ticked_s = self._start_s
        self._last = (self._start_s, self._pose, (0.0, 0.0))

    def upload(self, script: str) -> None:
        """Run a program, such as the control script of ur_rtde."""
        if self._safety_bits == _NORMAL_BIT and "rtde_cmd" in script:
            self._runtime_state, self._is_executing, self._watchdog_s = _PLAYING, False, math.inf
            self._outputs["output_int_register_0"] = 1

    def set_inputs(self, names: Sequence[str], values: Sequence[Value]) -> None:
        """Take over the values of a client's data package."""
        self.inputs.update(zip(names, values, strict=True))
        if "input_int_register_0" in names:
            self._kicked_s = time.monotonic()

    def dashboard(self, line: str) -> str:
        """Answer to a line on the dashboard port."""
        match line.strip().lower():
            case "polyscopeversion":
                return f"URSoftware {self.version} (simulated)"
            case "get serial number":
                return self.serial_number
            case "get robot model":
                return "UR3"
            case "is in remote control":
                return "true"
            case "safetystatus" | "safetymode":
                return (
                    "Safetystatus: NORMAL"
                    if self._safety_bits == _NORMAL_BIT
                    else "Safetystatus: PROTECTIVE_STOP"
                )
            case "unlock protective stop":
                if self._safety_bits == _PROTECTIVE_BIT:
                    self._safety_bits = _NORMAL_BIT
                return "Protective stop releasing"
            case "stop":
                self._stop_program()
                return "Stopped"
        return "could not understand"

    def protective_stop(self) -> None:
        """Stop, as if the arm had hit an obstacle."""
        self._safety_stop(_PROTECTIVE_BIT)

    def emergency_stop(self) -> None:
        """Stop, as if somebody had pressed the emergency stop."""
        self._safety_stop(_EMERGENCY_BIT)

    def tick(self) -> None:
        """Run one control cycle."""
        now_s = time.monotonic()
        self._kicked_s += max(0.0, now_s - self._ticked_s - _LONGEST_CYCLE_S)
        self._ticked_s = now_s
        if self._runtime_state != _PLAYING:
            return
        if now_s - self._kicked_s > self._watchdog_s:
            self._stop_program()
            return
        if self._is_async and not self._world.is_moving(self._arm):
            self._finish_async()
        command = self._int("input_int_register_0")
        if command == 0:
            self._is_executing = False
            self._outputs["output_int_register_0"] = 1
        elif not self._is_executing:
            self._is_executing = True
            self._begin(command)
        if self._is_executing and (self._is_async or not self._world.is_moving(self._arm)):
            self._outputs["output_int_register_0"] = 2

    def outputs(self, names: Sequence[str], cycle_s: float) -> list[Value]:
        """Present values of variables, all at the same instant.

        Args:
            names: Names of the variables.
            cycle_s: When the control cycle was due; the time stamp follows this even if the process is late.
        """
        now_s = time.monotonic()
        pose = self._pose
        last_s, last_pose, speed = self._last
        if now_s - last_s > 1e-3:
            turn_rad = angle_between_rad(last_pose.rotation_vector_rad, pose.rotation_vector_rad)
            speed = (distance_m(last_pose, pose) / (now_s - last_s), turn_rad / (now_s - last_s))
            self._last = (now_s, pose, speed)
        numbers = (*pose.position_m, *pose.rotation_vector_rad)
        is_running = self._runtime_state == _PLAYING
        values: dict[str, Value] = {
            **self._outputs,
            "timestamp": cycle_s - self._start_s,
            "actual_TCP_pose": numbers,
            "actual_q": numbers,
            "actual_TCP_speed": (speed[0], 0.0, 0.0, speed[1], 0.0, 0.0),
            "runtime_state": self._runtime_state,
            "safety_status_bits": self._safety_bits,
            "robot_status_bits": _POWER_ON_BIT | (_PROGRAM_RUNNING_BIT if is_running else 0),
            "robot_mode": 7,
            "safety_mode": 1 if self._safety_bits == _NORMAL_BIT else 3,
            "speed_scaling": 1.0,
            "target_speed_fraction": 1.0,
        }
        return [values.get(name, _zero(name)) for name in names]

    @property
    def _pose(self) -> FlangePose:
        return self._world.pose(self._arm)

    def _begin(self, command: int) -> None:
        numbers = tuple(self._double(register) for register in range(6))
        match command:
            case 1 | 3:
                self._move(numbers, self._double(6), is_async=self._int("input_int_register_1") == 1)
            case 33 | 34:
                self._world.halt(self._arm)
                self._finish_async()
            case 29:
                self._tcp = numbers
            case 30 | 46:  # the joints of the simulated arm are the numbers of its pose
                self._write_doubles(numbers)
            case 35:
                frequency_Hz = self._double(0)
                self._watchdog_s = 1 / frequency_Hz if frequency_Hz > 0 else math.inf
                self._kicked_s = time.monotonic()
            case 36 | 37:
                reach_m = math.hypot(*numbers[:2], numbers[2] - _SHOULDER_M)
                self._outputs["output_int_register_1"] = int(reach_m <= self._reach_m)
            case 40:
                self._write_doubles(self._tcp)
            case 255:
                self._stop_program()

    def _move(self, numbers: tuple[float, ...], speed: float, *, is_async: bool) -> None:
        start = self._pose
        x_m, y_m, z_m, x_rad, y_rad, z_rad = numbers
        target = FlangePose((x_m, y_m, z_m), (x_rad, y_rad, z_rad))
        turn_rad = angle_between_rad(start.rotation_vector_rad, target.rotation_vector_rad)
        duration_s = max(distance_m(start, target) / speed, turn_rad / _FASTEST_ROTATION_RAD_PER_S)
        self._world.move(self._arm, target, duration_s)
        self._is_async = is_async
        if is_async:
            self._n_operations = (self._n_operations + 1) % 128
            self._outputs["output_int_register_2"] = self._n_operations << 24 | _ASYNC_RUNNING

    def _finish_async(self) -> None:
        self._is_async = False
        self._outputs["output_int_register_2"] = self._n_operations << 24

    def _stop_program(self) -> None:
        self._world.halt(self._arm)
        self._is_async = False  # its register still says "running": no program is left to write it
        self._runtime_state = _STOPPED
        self._outputs["output_int_register_0"] = 0

    def _safety_stop(self, bits: int) -> None:
        if self._safety_bits == _NORMAL_BIT:
            self._stop_program()
            self._safety_bits = bits

    def _write_doubles(self, values: Sequence[float]) -> None:
        self._outputs.update({f"output_double_register_{index}": value for index, value in enumerate(values)})

    def _int(self, name: str) -> int:
        value = self.inputs.get(name, 0)
        return int(value) if not isinstance(value, tuple) else 0

    def _double(self, register: int) -> float:
        value = self.inputs.get(f"input_double_register_{register}", 0.0)
        return float(value) if not isinstance(value, tuple) else 0.0


@cache
def _zero(name: str) -> Value:
    kind = kind_of(name)
    if kind.startswith("VECTOR"):
        return (0.0 if kind.endswith("D") else 0,) * (3 if kind == "VECTOR3D" else 6)
    return 0.0 if kind == "DOUBLE" else 0
