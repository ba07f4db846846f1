"""Reads every data package of a Universal Robots controller, without loss and with all values of one control cycle together.

The getters of ur_rtde read one variable after the other, its thread may take over the next package in between, and only the
newest package is kept. So this reader takes the packages themselves.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault, DriverError
from drivers.robots import rtde
from drivers.robots.rtde import Package, PackageType, Recipe, Value
from drivers.transport.port import Port

_MOST_SAMPLES = 60_000
"""Limit of the packages that may wait here: two minutes at 500 Hz."""

_WAKE_S = 0.2


@dataclass(frozen=True, slots=True)
class Sample:
    """One data package.

    Attributes:
        host_monotonic_s: When its last byte arrived.
        device_time_s: Time on the controller's clock.
        values: Values by name of the variable, all of one control cycle.
        is_after_loss: Whether packages just before this one never arrived, or were dropped here.
    """

    host_monotonic_s: float
    device_time_s: float
    values: dict[str, Value]
    is_after_loss: bool


class RtdeReader:
    """Owns an RTDE connection; a thread receives packages as they come, so arrival times are those of the network."""

    def __init__(
        self,
        port: Port,
        names: Sequence[str],
        frequency_Hz: float,
        *,
        timeout_s: float,
        on_loss: Callable[[], None] | None = None,
    ) -> None:
        """Set up the variables and start.

        Args:
            port: Connection to port 30004.
            names: Variables besides `timestamp`.
            frequency_Hz: At most 125 for a UR3, 500 for a UR3e.
            timeout_s: Time for the set-up.
            on_loss: Called by the reader's thread as soon as the connection breaks.

        Raises:
            DriverError: The controller refuses, or does not answer.
        """
        self.name = port.name
        self._port, self._on_loss = port, on_loss
        self._period_s = 1 / frequency_Hz
        self._rest = b""
        self._samples: deque[Sample] = deque()
        self._has_overflowed = False
        self._error: DriverError | None = None
        self._news = threading.Condition()
        self._is_closed = False
        self._latest: Sample | None = None
        deadline = Deadline.after(timeout_s)
        try:
            self._recipe = self._set_up(("timestamp", *names), frequency_Hz, deadline)
        except DriverError:
            port.close()
            raise
        self._thread = threading.Thread(target=self._run, name=f"RTDE {port.name}", daemon=True)
        self._thread.start()

    @property
    def is_lost(self) -> bool:
        """Whether the connection has broken; it is never restored."""
        return self._error is not None

    def read_new(self, *, timeout_s: float) -> list[Sample]:
        """All samples since the last call, oldest first; waits until there is one.

        Raises:
            DeadlineExceeded: No sample came.
            DeviceFault: The connection is lost; samples that came before are returned first.
        """
        deadline = Deadline.after(timeout_s)
        with self._news:
            self._news.wait_for(lambda: self._samples or self._error, deadline.remaining_s)
            if not self._samples:
                raise self._error or deadline.exceeded(f"{self.name} must send a package", "nothing came")
            samples = list(self._samples)
            self._samples.clear()
            return samples

    def read_after(self, host_monotonic_s: float, *, timeout_s: float) -> Sample:
        """The first sample, of those not yet returned, that arrived after a moment; older ones are discarded."""
        deadline = Deadline.after(timeout_s)
        while True:
            samples = self.read_new(timeout_s=deadline.remaining_s)
            for index, sample in enumerate(samples):
                if sample.host_monotonic_s > host_monotonic_s:
                    with self._news:
                        self._samples.extendleft(reversed(samples[index + 1 :]))
                    return sample

    def latest(self, *, at_most_s: float) -> Sample:
        """The newest sample, left in the queue.

        On a busy computer this process pauses as a whole. Then packages wait at its door, so an old sample is waited for before it counts
        as the last one.

        Args:
            at_most_s: Highest age that is accepted, and how long a newer sample is waited for.

        Raises:
            DeadlineExceeded: The newest sample is older, so the stream has stalled.
            DeviceFault: The connection is lost.
        """
        with self._news:
            if self._error is not None:
                raise self._error
            self._news.wait_for(lambda: self._age_s() <= at_most_s or self._error is not None, at_most_s)
            latest, age_s = self._latest, self._age_s()
        if latest is None or age_s > at_most_s:
            raise DeadlineExceeded(
                f"{self.name} must send a package every {self._period_s:g} s; the last came {age_s:.2f} s ago"
            )
        return latest

    def _age_s(self) -> float:
        return float("inf") if self._latest is None else time.monotonic() - self._latest.host_monotonic_s

    def close(self) -> None:
        """End the connection; a second call does nothing."""
        if not self._is_closed:
            self._is_closed = True
            self._port.close()
            self._thread.join(2 * _WAKE_S)

    def _set_up(self, names: tuple[str, ...], frequency_Hz: float, deadline: Deadline) -> Recipe:
        version = Package(PackageType.REQUEST_PROTOCOL_VERSION, bytes([0, 2]))
        if self._ask(version, deadline).payload != b"\x01":
            raise DeviceFault(f"RTDE must speak protocol 2; the controller refuses ({self.name})")
        recipe = rtde.decode_recipe(
            self._ask(rtde.encode_output_request(names, frequency_Hz), deadline).payload, names
        )
        if self._ask(Package(PackageType.START, b""), deadline).payload != b"\x01":
            raise DeviceFault(f"RTDE must start to send; the controller refuses ({self.name})")
        return recipe

    def _ask(self, package: Package, deadline: Deadline) -> Package:
        """Ask, and return the answer, which has the type of the question; the controller may send other packages before it."""
        self._port.send(rtde.encode(package), deadline)
        while True:
            packages, self._rest = rtde.split(self._rest)
            for index, answer in enumerate(packages):
                if answer.type is package.type:
                    # Data that follow the answer to START belong to the stream.
                    self._rest = b"".join(map(rtde.encode, packages[index + 1 :])) + self._rest
                    return answer
            self._rest += self._port.receive(deadline)

    def _run(self) -> None:
        try:
            while not self._is_closed:
                self._take(self._rest)
                try:
                    self._rest += self._port.receive(Deadline.after(_WAKE_S))
                except DeadlineExceeded:
                    continue
        except DriverError as error:
            if self._on_loss is not None and not self._is_closed:
                self._on_loss()
            with self._news:
                self._error = error
                self._news.notify_all()

    def _take(self, stream: bytes) -> None:
        packages, self._rest = rtde.split(stream)
        arrived_s = time.monotonic()
        for package in packages:
            if package.type is PackageType.DATA:
                self._add_sample(rtde.decode_data(package.payload, self._recipe), arrived_s)

    def _add_sample(self, values: dict[str, Value], arrived_s: float) -> None:
        device_time_s = values["timestamp"]
        assert isinstance(device_time_s, float)
        last = self._latest
        has_gap = last is not None and device_time_s - last.device_time_s > 1.5 * self._period_s
        with self._news:
            sample = Sample(arrived_s, device_time_s, values, has_gap or self._has_overflowed)
            self._has_overflowed = len(self._samples) >= _MOST_SAMPLES
            if self._has_overflowed:
                self._samples.clear()
            else:
                self._samples.append(sample)
            self._latest = sample
            self._news.notify_all()
