"""Relates the clock of an instrument to that of the host, by readings that bear a time of both."""

from __future__ import annotations

from collections import deque
from statistics import fmean

WINDOW = (
    200  # readings over which the clocks are taken to run alike: 100 ppm are a millisecond in ten seconds
)

LONGEST_DELAY_S = 2.0  # beyond, somebody has set the instrument's clock


class DeviceClock:
    """When a reading was taken on the host's clock, and how late it arrived.

    The fastest reading of late tells the offset of the clocks, but for the shortest time that a message takes at all: that part
    of the latency cannot be seen from one side (Mills, Network Time Protocol, RFC 5905, section 8).

    Examples:
        >>> clock = DeviceClock()
        >>> for host_s, device_s in ((100.003, 0.0), (100.101, 0.1), (100.209, 0.2)):
        ...     clock.add(host_s, device_s)
        >>> round(clock.offset_s, 6), round(clock.delay_s, 6), round(clock.on_host_s(0.2), 6)
        (100.001, 0.003333, 100.201)
    """

    def __init__(self) -> None:
        self._differences_s: deque[float] = deque(maxlen=WINDOW)

    def add(self, host_s: float, device_s: float) -> None:
        """Take a reading into account: when it arrived, and when the instrument says that it took it."""
        difference_s = host_s - device_s
        if self._differences_s and abs(difference_s - self.offset_s) > LONGEST_DELAY_S:
            self._differences_s.clear()
        self._differences_s.append(difference_s)

    @property
    def offset_s(self) -> float:
        """Host's clock less the instrument's."""
        return min(self._differences_s)

    @property
    def delay_s(self) -> float:
        """How much later than the fastest of them readings arrive, on average."""
        return fmean(self._differences_s) - self.offset_s

    def on_host_s(self, device_s: float) -> float:
        """A time of the instrument on the host's clock."""
        return device_s + self.offset_s
