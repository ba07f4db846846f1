"""Simulated supplies: Kepco BOP, plain SCPI, Korad KA3005P. Each drives one coil of the world."""

from __future__ import annotations

import re
import time

from drivers.simulated.scpi import Handler, ScpiError, ScpiInstrument
from drivers.simulated.world import World


class SupplyOutput:
    """Output stage of a supply that regulates the current within a voltage limit."""

    def __init__(self, world: World, coil: int) -> None:
        self._world, self._coil = world, coil
        self.set_point_A, self.limit_V, self.is_on = 0.0, 0.0, False
        self.is_latched_off = False
        """Whether a protection holds the output off, whatever it was programmed to (`is_on`)."""

    def apply(self) -> None:
        """Drive the coil with the present settings."""
        highest_A = self.limit_V / self._world.circuits[self._coil].resistance_ohm
        target_A = (
            max(-highest_A, min(highest_A, self.set_point_A))
            if self.is_on and not self.is_latched_off
            else 0.0
        )
        self._world.drive(self._coil, target_A)

    @property
    def current_A(self) -> float:
        """Present current in the coil."""
        return self._world.snapshot().currents_A[self._coil]

    @property
    def voltage_V(self) -> float:
        """Voltage across the coil at a steady current."""
        return self.current_A * self._world.circuits[self._coil].resistance_ohm

    @property
    def is_limited(self) -> bool:
        """Whether the voltage limit holds the current back."""
        needed_V = abs(self.set_point_A) * self._world.circuits[self._coil].resistance_ohm
        return self.is_on and needed_V > self.limit_V


class SimulatedScpiSupply(ScpiInstrument):
    """A SCPI supply; starts with its set-point far from zero and its output off, as some supplies do after `*RST`."""

    def __init__(
        self,
        world: World,
        coil: int,
        *,
        lowest_A: float,
        highest_A: float,
        model: str,
        terminator: str,
        is_kepco: bool,
    ) -> None:
        self._output = SupplyOutput(world, coil)
        self._output.set_point_A = highest_A
        self._lowest_A, self._highest_A = lowest_A, highest_A
        self._model = model
        self._is_remote, self._is_current_mode = not is_kepco, not is_kepco
        kepco: dict[str, Handler] = {
            "SYST:REM": self._set_remote,
            "FUNC:MODE": self._set_mode,
            "FUNC:MODE?": lambda _: str(int(self._is_current_mode)),
        }
        plain: dict[str, Handler] = {
            "OUTP:PROT:WDOG": self._set_watchdog,
            "OUTP:PROT:WDOG:DEL": self._set_watchdog_delay,
            "OUTP:PROT:CLE": self._clear_protection,
        }
        self._watchdog_s, self._has_watchdog, self._heard_s = 60.0, False, time.monotonic()
        super().__init__({**self._common(), **(kepco if is_kepco else plain)}, terminator)

    def take(self, data: bytes) -> bytes:
        """See `Instrument.take`."""
        self._heard_s = time.monotonic()
        return super().take(data)

    def stream(self) -> bytes:
        """See `Instrument.stream`; called often, so the watchdog looks at the clock here."""
        if self._has_watchdog and time.monotonic() - self._heard_s > self._watchdog_s:
            self._output.is_latched_off = True
            self._output.apply()
        return b""

    def _common(self) -> dict[str, Handler]:
        output = self._output
        return {
            "*IDN?": lambda _: self._model,
            "CURR": self._set_current,
            "CURR?": lambda _: f"{output.set_point_A:+.6E}",
            "VOLT": self._set_voltage,
            "VOLT?": lambda _: f"{output.limit_V:+.6E}",
            "OUTP": self._switch,
            "OUTP?": lambda _: str(int(output.is_on)),
            "MEAS:CURR?": lambda _: f"{output.current_A:+.6E}",
            "MEAS:VOLT?": lambda _: f"{output.voltage_V:+.6E}",
        }

    def _set_current(self, argument: str) -> None:
        current_A = float(argument)
        if not self._lowest_A <= current_A <= self._highest_A:
            raise ScpiError('-222,"Data out of range"')
        self._output.set_point_A = current_A
        self._output.apply()

    def _set_voltage(self, argument: str) -> None:
        self._output.limit_V = float(argument)
        self._output.apply()

    def _set_remote(self, argument: str) -> None:
        self._is_remote = argument == "1"

    def _set_watchdog(self, argument: str) -> None:
        self._has_watchdog = argument.upper() in {"ON", "1"}

    def _set_watchdog_delay(self, argument: str) -> None:
        if not 1.0 <= float(argument) <= 3600.0:
            raise ScpiError('-222,"Data out of range"')
        self._watchdog_s = float(argument)

    def _clear_protection(self, _: str) -> None:
        self._output.is_latched_off = False
        self._output.apply()

    def _set_mode(self, argument: str) -> None:
        self._is_current_mode = argument.upper() == "CURR"

    def _switch(self, argument: str) -> None:
        if not self._is_remote or not self._is_current_mode:
            raise ScpiError('-221,"Settings conflict"')
        if argument.upper() not in {"ON", "OFF", "1", "0"}:
            raise ScpiError('-104,"Data type error"')
        self._output.is_on = argument.upper() in {"ON", "1"}
        self._output.apply()


def simulated_scpi_supply(world: World, coil: int, highest_A: float) -> SimulatedScpiSupply:
    """A unipolar supply that speaks plain SCPI."""
    model = "COILCAL,SCPI SUPPLY,0,1.0"
    return SimulatedScpiSupply(
        world, coil, lowest_A=0.0, highest_A=highest_A, model=model, terminator="\n", is_kepco=False
    )


def simulated_kepco(world: World, coil: int, highest_A: float) -> SimulatedScpiSupply:
    """A Kepco BOP: bipolar, obeys only under remote control, and leaves flow-control bytes in its answers."""
    return SimulatedScpiSupply(
        world,
        coil,
        lowest_A=-highest_A,
        highest_A=highest_A,
        model="KEPCO,BOP 50-20M,A12345,2.1",
        terminator="\x11\r\n\x13",
        is_kepco=True,
    )


class SimulatedKorad:
    """A Korad KA3005P: no terminators, and commands in quick succession are lost."""

    _COMMAND = re.compile(
        rb"\*IDN\?|STATUS\?|[IV](?:SET|OUT)1\?|ISET1:\d\.\d{3}|VSET1:\d{1,2}\.\d\d|OUT[01]|O[CV]P[01]"
    )
    _GAP_S = 0.05

    def __init__(self, world: World, coil: int) -> None:
        self._output = SupplyOutput(world, coil)
        self._arrived = b""
        self._last_s = 0.0

    def take(self, data: bytes) -> bytes:
        """See `Instrument.take`."""
        now_s = time.monotonic()
        is_too_fast, self._last_s = now_s - self._last_s < self._GAP_S, now_s
        self._arrived += data
        answers = []
        while match := self._COMMAND.search(self._arrived):
            self._arrived = self._arrived[match.end() :]
            if not is_too_fast:
                answers.append(self._execute(match[0].decode("ascii")))
        return b"".join(answers)

    def stream(self) -> bytes:
        """See `Instrument.stream`."""
        return b""

    def _execute(self, command: str) -> bytes:
        output = self._output
        queries = {
            "*IDN?": "KORADKA3005PV2.0",
            "ISET1?": f"{output.set_point_A:05.3f}K",  # the stray sixth character
            "VSET1?": f"{output.limit_V:05.2f}",
            "IOUT1?": f"{abs(output.current_A):05.3f}",
            "VOUT1?": f"{output.voltage_V:05.2f}",
        }
        if command in queries:
            return queries[command].encode("ascii")
        if command == "STATUS?":
            return bytes(
                [(0x40 if output.is_on else 0) | (0x01 if output.is_limited or not output.is_on else 0)]
            )
        if command.startswith("ISET1:"):
            output.set_point_A = min(5.0, float(command[6:]))
        elif command.startswith("VSET1:"):
            output.limit_V = float(command[6:])
        elif command in {"OUT0", "OUT1"}:
            output.is_on = command == "OUT1"
        output.apply()
        return b""
