"""What opens a supply, once its settings in a rig file are read; picklable, for its child process opens it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers.port_settings import PortSettings
from drivers.supplies.commands import SupplyCommands
from drivers.transport.port import Port


@dataclass(frozen=True, slots=True)
class Rating:
    """What a supply may deliver, as its settings say.

    Attributes:
        lowest_A, highest_A: Limits of its coil.
        compliance_V: Voltage limit.
        tolerance_A: Of a set-point that is read back.
    """

    lowest_A: float
    highest_A: float
    compliance_V: float
    tolerance_A: float


@dataclass(frozen=True, slots=True)
class SupplyOpener:
    """Opens a supply.

    Attributes:
        port: How it is connected.
        make: Its commands over the open port.
    """

    port: PortSettings
    make: Callable[[Port], SupplyCommands]

    def __call__(self) -> SupplyCommands:
        """Open it.

        Raises:
            DeviceFault: It is not there, not permitted, or another process has it.
        """
        return self.make(self.port.open())
