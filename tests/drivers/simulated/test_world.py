"""The shared world of simulated instruments, read by one of them while another changes it."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

from drivers.protocols import FlangePose
from drivers.simulated.world import CoilCircuit, World


def test_a_reader_that_waited_for_a_change_sees_the_world_after_it():
    """A reader that looked at the clock before it waited would find a motion that begins in its future."""
    world = World([CoilCircuit(resistance_ohm=2.0, inductance_H=0.0)])
    reads = threading.Event()

    def read() -> tuple[FlangePose, ...]:
        reads.set()
        return world.snapshot().base_from_flange

    with ThreadPoolExecutor(1) as reader:
        with world._cells:
            seen = reader.submit(read)
            assert reads.wait(10.0)
            time.sleep(0.05)  # the reader waits for the lock now
            world.halt(0)
        assert seen.result(10.0) == (world.pose(0),)
