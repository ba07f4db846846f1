r"""Records the calls of an arm and its answers as a transcript (`drivers.transport.transcript`), and replays them.

Other instruments are recorded as bytes of their port. An arm has three ports and a library that uses them by itself, so its transcript
holds calls of `RobotArm` instead: a line such as `read_pose` one way, and JSON the other.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from drivers.deadline import Deadline
from drivers.device import ClosesItself
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError, Refused
from drivers.protocols import FlangePose, Reading, ReadingFlag, RobotArm
from drivers.readings import ReadingCounter, quoted
from drivers.robots.ur_motion import numbers_of
from drivers.transport.channel import Channel
from drivers.transport.transcript import Chunk, ReplayedPort, TranscriptFile

Value = TypeVar("Value")

_END = b"\n"
_IDENTIFY, _READ_POSE = b"identify" + _END, b"read_pose" + _END
_ERRORS: dict[str, type[DriverError]] = {
    kind.__name__: kind for kind in (DeadlineExceeded, DeviceFault, Refused)
}


def encode_motion(base_from_flange: FlangePose, speed_m_per_s: float) -> bytes:
    r"""The line that asks for a motion: position, rotation vector and speed in SI.

    Examples:
        >>> encode_motion(FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0)), 0.1)
        b'move_to [0.3, 0.0, 0.2, 0.0, 3.0, 0.0] 0.1\n'
    """
    return f"move_to {numbers_of(base_from_flange)} {speed_m_per_s}".encode("ascii") + _END


def encode_pose(reading: Reading[FlangePose]) -> dict[str, Any]:
    """The part of a reading that does not depend on when it is replayed.

    Examples:
        >>> encode_pose(Reading(7, 12.5, 0.25, FlangePose((0.3, 0.0, 0.2), (0.0, 3.0, 0.0)), ReadingFlag.STALE))
        {'pose': [0.3, 0.0, 0.2, 0.0, 3.0, 0.0], 'device_time_s': 0.25, 'flags': ['STALE']}
    """
    return {
        "pose": numbers_of(reading.value),
        "device_time_s": reading.device_time_s,
        "flags": [flag.name for flag in reading.flags],
    }


def decode_pose(answer: Any) -> tuple[FlangePose, float | None, ReadingFlag]:
    """Pose, device time and flags of a recorded reading.

    Raises:
        DeviceFault: The answer has another format.

    Examples:
        >>> decode_pose({"pose": [0.3, 0.0, 0.2, 0.0, 3.0, 0.0], "device_time_s": 0.25, "flags": ["STALE"]})[1:]
        (0.25, <ReadingFlag.STALE: 1>)
    """
    try:
        x_m, y_m, z_m, x_rad, y_rad, z_rad = (float(value) for value in answer["pose"])
        flags = ReadingFlag.NONE
        for name in answer["flags"]:
            flags |= ReadingFlag[name]
        return FlangePose((x_m, y_m, z_m), (x_rad, y_rad, z_rad)), answer["device_time_s"], flags
    except (KeyError, TypeError, ValueError) as error:
        raise DeviceFault(
            f"a recorded pose must have pose, device_time_s and flags; received {answer!r}"
        ) from error


class RecordingArm(ClosesItself):
    """Records the calls of an arm and its answers and faults; calls of two threads stand in the order in which they ended.

    `stop`, and `require_safe`, which is called at any time, are not recorded: a replay has no use for them.
    """

    def __init__(self, arm: RobotArm, path: Path, *, name: str) -> None:
        """Record to a file; an existing file is appended to. The arm is called `name` in messages."""
        self._arm, self._file = arm, TranscriptFile(path, name)

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return self._recorded(_IDENTIFY, lambda: self._arm.identify(timeout_s=timeout_s), str)

    def read_pose(self, *, timeout_s: float) -> Reading[FlangePose]:
        """See `RobotArm.read_pose`."""
        return self._recorded(_READ_POSE, lambda: self._arm.read_pose(timeout_s=timeout_s), encode_pose)

    def require_safe(self) -> None:
        """See `RobotArm.require_safe`."""
        self._arm.require_safe()

    def move_to(self, base_from_flange: FlangePose, *, speed_m_per_s: float, timeout_s: float) -> None:
        """See `RobotArm.move_to`."""

        def move() -> None:
            self._arm.move_to(base_from_flange, speed_m_per_s=speed_m_per_s, timeout_s=timeout_s)

        self._recorded(encode_motion(base_from_flange, speed_m_per_s), move, lambda _: "arrived")

    def stop(self, *, timeout_s: float) -> None:
        """See `RobotArm.stop`."""
        self._arm.stop(timeout_s=timeout_s)

    def close(self) -> None:
        """See `Device.close`."""
        try:
            self._arm.close()
        finally:
            self._file.close()

    def _recorded(self, question: bytes, ask: Callable[[], Value], encode: Callable[[Value], Any]) -> Value:
        asked = Chunk(self._file.now_s, ">", question)

        def write(answer: Any) -> None:
            self._file.write(asked, Chunk(self._file.now_s, "<", json.dumps(answer).encode("ascii") + _END))

        try:
            value = ask()
        except DriverError as error:
            write({"error": type(error).__name__, "text": str(error)})
            raise
        write(encode(value))
        return value


class ReplayedArm(ClosesItself):
    """Plays a recorded arm, with the recorded timing; the calls must be the recorded ones (see `ReplayedPort`).

    Nothing moves, so `stop` always succeeds and no safety stop holds it.
    """

    def __init__(self, path: Path) -> None:
        """Read the recording.

        Raises:
            DeviceFault: The file cannot be read.
        """
        self._channel = Channel(ReplayedPort.from_file(path))
        self._counter = ReadingCounter()

    def identify(self, *, timeout_s: float) -> str:
        """See `Device.identify`."""
        return self._ask(_IDENTIFY, str, timeout_s)

    def read_pose(self, *, timeout_s: float) -> Reading[FlangePose]:
        """See `RobotArm.read_pose`; flags and device time are the recorded ones."""
        pose, device_time_s, flags = self._ask(_READ_POSE, decode_pose, timeout_s)
        return self._counter.reading(
            pose, flags, host_monotonic_s=self._channel.arrived_s, device_time_s=device_time_s
        )

    def require_safe(self) -> None:
        """See `RobotArm.require_safe`."""

    def move_to(self, base_from_flange: FlangePose, *, speed_m_per_s: float, timeout_s: float) -> None:
        """See `RobotArm.move_to`; takes as long as the recorded motion, and ends as it ended."""
        self._ask(encode_motion(base_from_flange, speed_m_per_s), str, timeout_s)

    def stop(self, *, timeout_s: float) -> None:
        """See `RobotArm.stop`."""

    def close(self) -> None:
        """See `Device.close`."""
        self._channel.close()

    def _ask(self, question: bytes, decode: Callable[[Any], Value], timeout_s: float) -> Value:
        """The recorded answer.

        Raises:
            DriverError: The arm answered with an error, or another question was recorded.
        """
        deadline = Deadline.after(timeout_s)
        with self._channel.exchange(deadline):
            line = self._channel.query(question, _END, deadline)
            try:
                answer = json.loads(line)
            except ValueError as error:
                raise DeviceFault(f"a recorded arm must answer in JSON; received {quoted(line)}") from error
            if not isinstance(answer, dict) or "error" not in answer:
                return decode(answer)
        kind = _ERRORS.get(answer["error"], DeviceFault)
        raise kind(f"{answer.get('text')}, as recorded in {self._channel.name}")
