"""What one model of power supply can be told, one command each; `drivers.supplies.ramped` makes a source of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from drivers.deadline import Deadline


@dataclass(frozen=True, slots=True)
class Measured:
    """What a supply measures at its output.

    Attributes:
        current_A: Positive out of the positive terminal.
        is_regulating: Whether it holds the current; False where the voltage limit (compliance) was reached first.
    """

    current_A: float
    is_regulating: bool


class SupplyCommands(Protocol):
    """The commands of one model; each ends when the device has confirmed it, as far as the model can.

    Attributes:
        name: Port it is connected to.
        lowest_A: Least current; zero for a unipolar supply.
        highest_A: Greatest current.
        resolution_A: Step between two set-points; one read back may differ by as much.
        step_s: Time between two set-points of a ramp, in which the model takes one and reads it back.
    """

    name: str
    lowest_A: float
    highest_A: float
    resolution_A: float
    step_s: float

    def identify(self, deadline: Deadline) -> str:
        """Maker, model, serial number."""
        ...

    def prepare(self, deadline: Deadline) -> None:
        """Remote control, regulation of the current, voltage limit; leaves output and set-point as they are."""
        ...

    def write_set_point(self, current_A: float, deadline: Deadline) -> None:
        """Ask for a current."""
        ...

    def read_set_point_A(self, deadline: Deadline) -> float:
        """The current that the device believes it was asked for."""
        ...

    def switch_output(self, is_on: bool, deadline: Deadline) -> None:
        """Output on or off."""
        ...

    def is_output_on(self, deadline: Deadline) -> bool:
        """Whether the device says that its output is on."""
        ...

    def measure(self, deadline: Deadline) -> Measured:
        """Current at the output."""
        ...

    def close(self) -> None:
        """Release the port; a second call does nothing."""
        ...
