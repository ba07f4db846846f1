"""Independent pieces of one calculation on several processor cores at once, in threads.

Tensor operations let other threads run, so that two climbs side by side take little more time than the longer one. Several threads for
each operation, which PyTorch can use too, make them slower: the operations are too short.
Results do not depend on the number of cores. A process that another one has started, as one of several workers, uses one.
"""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import cache, partial
from typing import Generic, TypeVar

from estimator.tensors import torch

Item = TypeVar("Item")
Result = TypeVar("Result")

# Between two operations Python lets one thread run at a time, so that many threads wait for each other.
MOST_CORES = 4

_is_inside: ContextVar[bool] = ContextVar("_is_inside", default=False)


def n_cores() -> int:
    """Number of cores that pieces of a calculation run on: a few of those that this process may use."""
    if multiprocessing.parent_process() is not None:
        return 1
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(allowed, MOST_CORES)


def each(function: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Results of a function for some items in their order, as `map` gives them, but several are computed at once.

    The thread that asks computes too, and never waits for what nobody has begun: it may hold a lock that other work waits for.

    Args:
        function: Must not depend on what it did for other items. What it does in turn runs on one core.
        items: What it is called with. Where one raises an error, those that were not begun are left out.

    Examples:
        >>> list(each(lambda x: x * x, [1, 2, 3]))
        [1, 4, 9]
    """
    items = list(items)
    if len(items) < 2 or _is_inside.get() or n_cores() < 2:
        yield from map(function, items)
        return
    pieces = [_Piece(partial(function, item)) for item in items]
    try:
        for i, piece in enumerate(pieces):
            later = iter(pieces[i:])
            while not piece.is_done and (own := next(filter(_Piece.is_free, later), None)):
                own.run()
            yield piece.result()
    finally:
        for piece in pieces:
            piece.is_free()  # nobody begins it any more


def meanwhile(function: Callable[[], Result]) -> Callable[[], Result]:
    """Begin a calculation beside what follows; the function that is returned waits for its result.

    Where no other core has begun it, it is done when its result is asked for.

    Examples:
        >>> later = meanwhile(lambda: 6 * 7)
        >>> later()
        42
    """
    if _is_inside.get() or n_cores() < 2:
        return function
    piece = _Piece(function)

    def result() -> Result:
        if piece.is_free():
            piece.run()
        return piece.result()

    return result


@contextmanager
def one_thread_for_an_operation() -> Iterator[None]:
    """While it lasts, PyTorch divides no operation among threads: of a few hundred numbers each, they would wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


class _Piece(Generic[Result]):
    """A call that the first free thread makes, in the context in which it was planned.

    Args:
        function: What is called.
    """

    def __init__(self, function: Callable[[], Result]) -> None:
        self._function, self._context = function, copy_context()
        self._has_gradients = torch.is_grad_enabled()
        self._outcome: Future[Result] = Future()
        self._is_taken = False
        self._planned = _threads().submit(self.run)

    def is_free(self) -> bool:
        """Whether no thread has begun it, nor was told so: from then on none does but the one that asks."""
        if self._is_taken:
            return False
        self._is_taken = self._planned.cancel()
        return self._is_taken

    def run(self) -> None:
        """Make the call, and keep its result or error."""
        try:
            self._outcome.set_result(self._context.run(self._inside))
        except BaseException as error:
            self._outcome.set_exception(error)
            if not isinstance(error, Exception):  # an interrupt is not kept until its turn
                raise

    def _inside(self) -> Result:
        _is_inside.set(True)
        with torch.set_grad_enabled(self._has_gradients):
            return self._function()

    @property
    def is_done(self) -> bool:
        return self._outcome.done()

    def result(self) -> Result:
        """Result of the call, once it is made."""
        return self._outcome.result()


@cache
def _threads() -> ThreadPoolExecutor:
    """Threads beside the one that asks."""
    return ThreadPoolExecutor(n_cores() - 1, thread_name_prefix="side by side")


if hasattr(os, "register_at_fork"):  # threads do not survive a fork
    os.register_at_fork(after_in_child=_threads.cache_clear)
