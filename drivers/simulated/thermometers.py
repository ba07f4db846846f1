"""A simulated Lake Shore 224, which measures the coils and the room of the world."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.simulated.scpi import Handler, ScpiInstrument
from drivers.simulated.world import World


class Simulated224(ScpiInstrument):
    """A Lake Shore 224; an input without a sensor reads 0 K, and only its status marks that as invalid."""

    def __init__(self, world: World, inputs: Mapping[str, int | None]) -> None:
        """Plug in the sensors.

        Args:
            world: World of the rig.
            inputs: Index of the coil that each input measures, by name of the input; None for the room.
        """
        self._world, self._inputs = world, dict(inputs)
        handlers: dict[str, Handler] = {
            "*IDN?": lambda _: "LSCI,MODEL224,LSA224A/LSA224B,1.0",
            "*ESR?": lambda _: "0",
            "KRDG?": self._kelvin,
            "RDGS?": lambda name: "000" if name in self._inputs else "128",
        }
        super().__init__(handlers, "\r\n")

    def _kelvin(self, name: str) -> str:
        if name not in self._inputs:
            return "+0.00000"
        coil, now = self._inputs[name], self._world.snapshot()
        kelvin = now.room_temperature_K if coil is None else now.coil_temperatures_K[coil]
        return f"{kelvin:+.3f}"
