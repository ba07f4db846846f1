"""Calls functions periodically, by APScheduler: at most one call of each at a time, and an exception is logged and ends nothing."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from datetime import UTC, datetime

from apscheduler.schedulers.background import BackgroundScheduler


def scheduler_of(calls: Mapping[str, tuple[float, Callable[[], object]]]) -> BackgroundScheduler:
    """A scheduler, not started, that begins with a call of each function.

    Args:
        calls: Seconds between two calls, and the function, by what it does in a word.
    """
    # Below an error it tells of every call, and of every one that is left out because the one before it lasts.
    logging.getLogger("apscheduler").setLevel(logging.ERROR)
    scheduler = BackgroundScheduler(timezone=UTC)
    for name, (every_s, call) in calls.items():
        now = datetime.now(UTC)
        scheduler.add_job(
            call, "interval", seconds=every_s, name=name, misfire_grace_time=None, next_run_time=now
        )
    return scheduler
