"""Independent pieces of one calculation on several processor cores at once, in threads.

Tensor operations let other threads run. Two climbs of 512 readings and 150 numbers, side by side, take 0.6 of the time that they take one
after the other. Several threads for each operation, which PyTorch can use too, double that time: the operations are too short.
Results do not depend on the number of cores. A process that another one has started, as one of several workers, uses one.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from functools import cache
from typing import TypeVar

import torch

Item = TypeVar("Item")
Result = TypeVar("Result")

MOST_CORES = (
    4  # between two operations Python lets one thread run at a time, so that many threads wait for each other
)

_is_inside: ContextVar[bool] = ContextVar("_is_inside", default=False)


def n_cores() -> int:
    """Number of cores that pieces of a calculation run on: a few of those that this process may use."""
    if multiprocessing.parent_process() is not None:
        return 1
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(allowed, MOST_CORES)


def each(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Results of a function for some items in their order, as `map` gives them, but several are computed at once.

    All are begun at the first. Where one raises an error, those that were not begun are left out.

    Args:
        function: Must not depend on what it did for other items. What it does in turn runs on one core.
        items: What it is called with.

    Examples:
        >>> list(each(lambda x: x * x, [1, 2, 3]))
        [1, 4, 9]
    """
    items = list(items)
    if len(items) < 2 or _is_inside.get() or n_cores() < 2:
        yield from map(function, items)
        return
    futures = [_begun(function, item) for item in items]
    try:
        for future in futures:
            yield future.result()
    finally:
        for future in futures:
            future.cancel()


def meanwhile(function: Callable[[], Result]) -> Callable[[], Result]:
    """Begin a calculation beside what follows; the function that is returned waits for its result.

    On one core it is done when its result is asked for.

    Examples:
        >>> later = meanwhile(lambda: 6 * 7)
        >>> later()
        42
    """
    if _is_inside.get() or n_cores() < 2:
        return function
    return _begun(lambda _: function(), None).result


def _begun(function: Callable[[Item], Result], item: Item) -> Future[Result]:
    """A call in another thread, in the context of this one."""
    context, has_gradients = copy_context(), torch.is_grad_enabled()

    def inside() -> Result:
        _is_inside.set(True)
        with torch.set_grad_enabled(has_gradients):
            return function(item)

    return _threads().submit(context.run, inside)


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(n_cores(), thread_name_prefix="side by side")


os.register_at_fork(after_in_child=_threads.cache_clear)  # threads do not survive a fork
