"""Relates the clock of an instrument to the clock of the host, from readings with time stamps of both."""

from __future__ import annotations

import math
from collections import deque
from statistics import fmean

WINDOW = 200
"""Readings over which both clocks are taken to run at the same rate: 100 ppm make a millisecond in ten seconds."""

LONGEST_DELAY_S = 2.0
"""After a longer apparent delay, the instrument's clock is taken to have been set."""

SLACK_S = 0.05
"""Contradiction that is allowed between two readings: clocks have a resolution, and their rates differ."""


class DeviceClock:
    """Offset of an instrument's clock from the host's, and delay of its readings.

    Of the recent readings, the one that arrived fastest gives the offset, up to the shortest latency of a message: that part cannot be
    seen from one side (Mills, Network Time Protocol, RFC 5905, section 8). The time of the request bounds the offset from the other
    side, for a reading is taken after its request and before its arrival. If the bounds of two readings contradict each other, the
    instrument's clock was set in between, and only the new setting counts from then on.

    Examples:
        >>> clock = DeviceClock()
        >>> for host_s, device_s in ((100.003, 0.0), (100.101, 0.1), (100.209, 0.2)):
        ...     clock.add(host_s, device_s)
        >>> round(clock.offset_s, 6), round(clock.delay_s, 6), round(clock.on_host_s(0.2), 6)
        (100.001, 0.003333, 100.201)
    """

    def __init__(self) -> None:
        # Lower and upper bound of the offset from each reading.
        self._bounds_s: deque[tuple[float, float]] = deque(maxlen=WINDOW)

    def add(self, host_s: float, device_s: float, asked_s: float = -math.inf) -> None:
        """Take a reading into account.

        Args:
            host_s: Arrival, on the host's clock.
            device_s: Time stamp, on the instrument's clock.
            asked_s: Time of the request, before the reading was taken, on the host's clock.
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
        """Host's clock minus the instrument's clock."""
        return min(high_s for _, high_s in self._bounds_s)

    @property
    def delay_s(self) -> float:
        """Mean delay of the readings relative to the fastest one."""
        return fmean(high_s for _, high_s in self._bounds_s) - self.offset_s

    def on_host_s(self, device_s: float) -> float:
        """Convert a time of the instrument to the host's clock."""
        return device_s + self.offset_s
