"""A simulated Lake Shore 224, which measures the coils and the room of the world."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.simulated.world import World

_OPEN_INPUT = "+0.00000", 128


class Simulated224:
    """A Lake Shore 224; an input without a sensor reads 0 K, and only its status marks that as invalid."""

    def __init__(self, world: World, inputs: Mapping[str, int | None]) -> None:
        """Plug in the sensors.

        Args:
            world: World of the rig.
            inputs: Index of the coil that each input measures, by name of the input; None for the room.
        """
        self._world, self._inputs = world, dict(inputs)
        self._arrived = b""

    def take(self, data: bytes) -> bytes:
        """See `Instrument.take`."""
        *lines, self._arrived = (self._arrived + data).split(b"\n")
        return b"".join(self._answer(line.decode("ascii", "replace").strip()) for line in lines)

    def stream(self) -> bytes:
        """See `Instrument.stream`."""
        return b""

    def _answer(self, line: str) -> bytes:
        answers = [
            answer for question in line.split(";") if (answer := self._execute(question.strip())) is not None
        ]
        return f"{';'.join(answers)}\r\n".encode("ascii") if answers else b""

    def _execute(self, question: str) -> str | None:
        command, _, name = question.partition(" ")
        match command.upper():
            case "*IDN?":
                return "LSCI,MODEL224,LSA224A/LSA224B,1.0"
            case "*ESR?":
                return "0"
            case "KRDG?":
                return self._read(name)[0]
            case "RDGST?":
                return f"{self._read(name)[1]:03d}"
        return None

    def _read(self, name: str) -> tuple[str, int]:
        """Value and status of an input."""
        if name not in self._inputs:
            return _OPEN_INPUT
        coil, now = self._inputs[name], self._world.snapshot()
        kelvin = now.room_temperature_K if coil is None else now.coil_temperatures_K[coil]
        return f"{kelvin:+.3f}", 0
