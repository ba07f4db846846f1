"""Relates the clock of an instrument to that of the host, by readings that bear a time of both."""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean

WINDOW = (
    200  # readings over which the clocks are taken to run alike: 100 ppm are a millisecond in ten seconds
)

LONGEST_DELAY_S = 2.0  # beyond, somebody has set the instrument's clock
SLACK_S = (
    0.05  # by which two readings may contradict each other: clocks have a resolution, and do not run alike
)


class DeviceClock:
    """When a reading was taken on the host's clock, and how late it arrived.

    The fastest reading of late tells the offset of the clocks, but for the shortest time that a message takes at all: that part
    of the latency cannot be seen from one side (Mills, Network Time Protocol, RFC 5905, section 8). The other side is when the reading was
    asked for: no reading was taken before that or after it arrived, and where the bounds of two contradict each other, somebody has set the
    instrument's clock in between, which then is believed from then on.

    Examples:
        >>> clock = DeviceClock()
        >>> for host_s, device_s in ((100.003, 0.0), (100.101, 0.1), (100.209, 0.2)):
        ...     clock.add(host_s, device_s)
        >>> round(clock.offset_s, 6), round(clock.delay_s, 6), round(clock.on_host_s(0.2), 6)
        (100.001, 0.003333, 100.201)
    """

    def __init__(self) -> None:
        self._bounds_s: deque[tuple[float, float]] = deque(
            maxlen=WINDOW
        )  # of the host's clock less the instrument's

    def add(self, host_s: float, device_s: float, asked_s: float = -math.inf) -> None:
        """Take a reading into account.

        Args:
            host_s: When it arrived.
            device_s: When the instrument says that it took it.
            asked_s: Before it was taken, on the host's clock.
        """
        low_s, high_s = asked_s - device_s, host_s - device_s
        if self._bounds_s:
            lowest_s = max(low_s for low_s, _ in self._bounds_s)
            is_set = low_s > self.offset_s + SLACK_S or high_s < lowest_s - SLACK_S
            if is_set or abs(high_s - self.offset_s) > LONGEST_DELAY_S:
                self._bounds_s.clear()
        self._bounds_s.append((low_s, high_s))

    @property
    def offset_s(self) -> float:
        """Host's clock less the instrument's."""
        return min(high_s for _, high_s in self._bounds_s)

    @property
    def delay_s(self) -> float:
        """How much later than the fastest of them readings arrive, on average."""
        return fmean(high_s for _, high_s in self._bounds_s) - self.offset_s

    def on_host_s(self, device_s: float) -> float:
        """A time of the instrument on the host's clock."""
        return device_s + self.offset_s
