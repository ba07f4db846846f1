"""A simulated Metrolab THM1176, on a serial line that carries the same messages as the real USB."""

from __future__ import annotations

import time
from functools import partial

from drivers.simulated.scpi import ScpiError, ScpiInstrument
from drivers.simulated.world import FieldFunction, World

_SAMPLE_S = 50e-6
"""Time for one sample of one axis: 100 samples take 5 ms."""


class SimulatedTHM1176(ScpiInstrument):
    """A THM1176, which measures the axes one after the other."""

    def __init__(self, world: World, field: FieldFunction) -> None:
        self._world, self._field = world, field
        self._range_T, self._n_averaged = 3.0, 1
        self._measured_T = [0.0, 0.0, 0.0]
        self._ended_s = self._start_s = time.monotonic()
        super().__init__(
            {
                "*IDN?": lambda _: "Metrolab Technology SA,THM1176-MF,0001,B:3.0-C:1.0",
                "*STB?": lambda _: str(4 * bool(self._errors)),
                "ABOR": lambda _: None,
                "SENS:FLUX:RANG": self._set_range,
                "SENS:FLUX:RANG:AUTO": lambda _: None,
                "AVER:COUN": self._set_averaging,
                "TRIG:SOUR": lambda _: None,
                "TRIG:COUN": lambda _: None,
                "INIT": lambda _: self._measure(),
                "INIT:CONT": lambda _: None,
                "FETC:TIM?": lambda _: f"0x{round(1e9 * (self._ended_s - self._start_s)):X}",
                **{f"FETC:ARR:{axis}?": partial(self._fetch, index) for index, axis in enumerate("XYZ")},
            },
            "\n",
        )

    def _set_range(self, argument: str) -> None:
        self._range_T = float(argument.upper().removesuffix("T"))

    def _set_averaging(self, argument: str) -> None:
        self._n_averaged = int(argument)

    def _measure(self) -> None:
        for axis in range(3):
            time.sleep(_SAMPLE_S * self._n_averaged)
            self._measured_T[axis] = self._field(self._world.snapshot())[axis]
        self._ended_s = time.monotonic()
        if any(abs(value_T) > self._range_T for value_T in self._measured_T):
            raise ScpiError('205,"Value over range"')

    def _fetch(self, axis: int, _: str) -> str:
        return f"{self._measured_T[axis]:+.8f} T"
