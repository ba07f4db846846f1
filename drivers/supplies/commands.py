"""Protocol of the commands of a power supply (`drivers.supplies.ramped` turns them into a source), and what opens one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.deadline import Deadline
from drivers.port_settings import PortSettings
from drivers.transport.port import Port


@dataclass(frozen=True, slots=True)
class Measured:
    """A measurement of a supply at its output.

    Attributes:
        current_A: Positive out of the positive terminal.
        is_regulating: Whether it holds the current; False if the voltage limit (compliance) was reached first.
    """

    current_A: float
    is_regulating: bool


class SupplyCommands(Protocol):
    """The commands of one model; each returns when the device has confirmed it, as far as the model can.

    Attributes:
        name: Port of the supply.
        lowest_A: Lowest current; zero for a unipolar supply.
        highest_A: Highest current.
        resolution_A: Step between two set-points; a set-point read back may differ by as much.
        step_s: Time between two set-points of a ramp, enough to write one and read it back.
        watchdog_s: Silence after which the supply switches itself off, once prepared; None if it has no such watchdog, or it is not used.
    """

    name: str
    lowest_A: float
    highest_A: float
    resolution_A: float
    step_s: float
    watchdog_s: float | None

    def identify(self, deadline: Deadline) -> str:
        """Maker, model and serial number."""
        ...

    def prepare(self, deadline: Deadline) -> None:
        """Set remote control, current regulation, voltage limit and watchdog; leave output and set-point as they are."""
        ...

    def write_set_point(self, current_A: float, deadline: Deadline) -> None:
        """Request a current."""
        ...

    def read_set_point_A(self, deadline: Deadline) -> float:
        """The requested current, as the device reports it."""
        ...

    def switch_output(self, is_on: bool, deadline: Deadline) -> None:
        """Switch the output on or off."""
        ...

    def is_output_on(self, deadline: Deadline) -> bool:
        """Whether the device reports that its output is on."""
        ...

    def send_set_point(self, current_A: float, deadline: Deadline) -> None:
        """Request a current and read nothing, as `cut` does."""
        ...

    def cut(self, deadline: Deadline) -> None:
        """Send current zero and then output off, and read nothing: the supply may no longer answer, but obey.

        Whether it obeyed, `is_output_on` tells afterwards.

        Raises:
            DeadlineExceeded: The port did not take the commands in time.
            DeviceFault: The connection is lost.
        """
        ...

    def measure(self, deadline: Deadline) -> Measured:
        """Measure the current at the output."""
        ...

    def disarm(self, deadline: Deadline) -> None:
        """Stop the watchdog of a supply that is off and will be left alone."""
        ...

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        ...


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
