"""Pieces of work of plain Python, such as pictures, side by side on the cores: each in a fork of the program.

matplotlib lets no other thread run, and a fresh process would load it anew for a second; a fork has it, and what is to be drawn, at once.
It shares the locks of the program's other threads, as they were. So it may compute nothing with torch, whose threads it lacks, and print
nothing; it draws, answers and ends, and waits for nobody. Where the system has no forks that are safe, and in workers, one piece follows
another.
"""

from __future__ import annotations

import gc
import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import TypeVar

from estimator.side_by_side import n_cores

Item = TypeVar("Item")
Result = TypeVar("Result")


def in_forks(function: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of a function for some items, in their order.

    Args:
        function: Depends on nothing but its item. Its result can be pickled.
        items: The last ones are begun first. What fails in a fork, or was ended there, is done once more here.

    Examples:
        >>> in_forks(lambda x: x * x, [1, 2, 3])
        [1, 4, 9]
    """
    results: dict[int, Result] = {}
    if len(items) > 1 and n_cores() > 1 and sys.platform == "linux":
        results.update(_forked(function, items))
    return [results[n] if n in results else function(item) for n, item in enumerate(items)]


def _forked(function: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[tuple[int, Result]]:
    """Number and result of each item whose fork answered, as they come."""
    context = multiprocessing.get_context("fork")
    waiting, running = list(enumerate(items)), dict[Connection, tuple[int, BaseProcess]]()
    while waiting or running:
        while waiting and len(running) < n_cores():
            n, item = waiting.pop()
            here, there = context.Pipe(duplex=False)
            fork = context.Process(target=_answer, args=(function, item, there), daemon=True)
            fork.start()
            there.close()
            running[here] = n, fork
        for answered in wait(list(running)):
            assert isinstance(answered, Connection)
            n, process = running.pop(answered)
            with suppress(EOFError, OSError), answered:
                yield n, answered.recv()
            process.join()


def _answer(function: Callable[[Item], Result], item: Item, connection: Connection) -> None:
    """Work of a fork. Ctrl-C is for the program that waits; whoever ends the fork itself, ends it."""
    gc.disable()  # a collection would look at all objects of the program, and so copy its memory page by page
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(Exception):
        connection.send(function(item))
