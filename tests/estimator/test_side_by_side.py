"""Pieces of a calculation side by side: the same results in the same order, errors, and what goes along into other threads."""

from __future__ import annotations

import threading
import time
from contextvars import ContextVar
from itertools import islice

import pytest
import torch

from estimator import side_by_side
from estimator.side_by_side import each, meanwhile

word: ContextVar[str] = ContextVar("word", default="nothing")


@pytest.fixture(params=[1, 2, 5])
def cores(request, monkeypatch):
    monkeypatch.setattr(side_by_side, "n_cores", lambda: request.param)
    side_by_side._threads.cache_clear()
    yield request.param
    side_by_side._threads.cache_clear()


def test_results_come_in_the_order_of_the_items(cores):
    later = threading.Event()

    def slow_at_first(number: int) -> int:
        if number == 0 and cores > 1:
            assert later.wait(10.0)  # until another one has ended
        later.set()
        return number**2

    assert list(each(slow_at_first, range(20))) == [number**2 for number in range(20)]
    assert list(each(slow_at_first, [])) == []


def test_more_than_one_runs_at_once_where_there_are_cores(cores):
    barrier = threading.Barrier(min(cores, 2))
    assert list(each(lambda _: barrier.wait(10.0) >= 0, range(2 if cores > 1 else 1))) == [True] * min(
        cores, 2
    )


@pytest.mark.usefixtures("cores")
def test_who_asks_never_waits_for_threads_that_wait_for_it():
    """Such as for a lock of `cached_property` in Python 3.11, which all objects of a class share."""
    lock = threading.Lock()

    def with_lock() -> bool:
        with lock:
            return True

    with lock:
        later = [meanwhile(with_lock) for _ in range(8)]
        assert list(each(abs, range(20))) == list(range(20))
    assert all(one() for one in later)


@pytest.mark.usefixtures("cores")
def test_an_error_is_raised_and_what_was_not_begun_is_left_out():
    begun = []

    def fails_at_once(number: int) -> int:
        begun.append(number)
        if number == 0:
            raise ValueError("no")
        time.sleep(1e-3)
        return number

    results = each(fails_at_once, range(2000))
    with pytest.raises(ValueError, match="no"):
        next(results)
    assert len(begun) < 2000
    assert list(islice(each(abs, [-1, -2]), 1)) == [1]


@pytest.mark.usefixtures("cores")
def test_each_piece_is_computed_once_however_long_others_take():
    called = []

    def waits(seconds: float) -> float:
        called.append(seconds)
        time.sleep(seconds)
        return seconds

    seconds = [0.02, 0.2, 0.15, *(1e-3 * number for number in range(30))]
    assert list(each(waits, seconds)) == seconds
    assert sorted(called) == sorted(seconds)


@pytest.mark.usefixtures("cores")
def test_context_and_gradients_go_along():
    def seen(_: int) -> tuple[str, bool, bool]:
        free = torch.ones(1).requires_grad_()
        return word.get(), torch.is_grad_enabled(), (2.0 * free).requires_grad

    token = word.set("a word")
    with torch.no_grad():
        assert list(each(seen, range(3))) == [("a word", False, False)] * 3
        assert meanwhile(lambda: seen(0))() == ("a word", False, False)
    assert list(each(seen, range(3))) == [("a word", True, True)] * 3
    word.reset(token)


@pytest.mark.usefixtures("cores")
def test_meanwhile_raises_where_its_result_is_asked_for():
    later = meanwhile(lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        later()
