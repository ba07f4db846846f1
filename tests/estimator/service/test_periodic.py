"""What is periodic begins at once, goes on after a failure, and never runs twice at a time."""

from __future__ import annotations

import threading
import time

from estimator.service.periodic import scheduler_of
from tests.estimator.service.conftest import until


def test_a_call_that_fails_is_logged_and_made_again_and_holds_up_no_other(caplog):
    calls: dict[str, list[float]] = {"fails": [], "lasts": [], "works": []}
    may_end = threading.Event()

    def fails() -> None:
        calls["fails"].append(time.monotonic())
        raise ValueError("the disk is full")

    def lasts() -> None:
        calls["lasts"].append(time.monotonic())
        may_end.wait(20.0)

    functions = {"fails": fails, "lasts": lasts, "works": lambda: calls["works"].append(time.monotonic())}
    begin_s = time.monotonic()
    scheduler = scheduler_of({name: (0.05, function) for name, function in functions.items()})
    scheduler.start()
    until(lambda: min(len(calls["fails"]), len(calls["works"])) >= 4)
    may_end.set()
    scheduler.shutdown()
    assert calls["works"][0] - begin_s < 5.0
    assert len(calls["lasts"]) <= 2
    assert {record.levelname for record in caplog.records} == {"ERROR"}
    assert "the disk is full" in caplog.text
