"""A command that keeps running by itself where no cron, systemd timer or Kubernetes does it."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from contextlib import suppress
from datetime import UTC, datetime

import click
from apscheduler.executors.debug import DebugExecutor
from apscheduler.jobstores.base import JobLookupError
from apscheduler.schedulers.blocking import BlockingScheduler

from estimator.errors import CoilcalError, InvalidInput

INTERVAL = re.compile(r"(?P<number>\d+(\.\d+)?)(?P<unit>[smhd])")
SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}


def interval_s(text: str) -> float:
    """Seconds of a time such as 6h.

    Raises:
        InvalidInput: It looks otherwise, or is shorter than a second.
    Examples:
        >>> interval_s("6h"), interval_s("1.5m")
        (21600.0, 90.0)
    """
    match = INTERVAL.fullmatch(text)
    seconds = float(match["number"]) * SECONDS[match["unit"]] if match else 0.0
    if seconds < 1.0:
        raise InvalidInput(f"--every must be a time such as 30s, 15m, 6h or 1d; received {text!r}")
    return seconds


def keep_running(job: Callable[[], object], every_s: float) -> None:
    """Run a job now and at every interval until SIGTERM or Ctrl-C, which interrupt it: it has to bear that at any instant.

    A fault that coilcal or the system can explain is said and does not end it: an inbox that is not mounted now may be there the next time.
    """
    # The job runs in this thread, where signals arrive.
    scheduler = BlockingScheduler(executors={"default": DebugExecutor()}, timezone=UTC)

    def stop(*_: object) -> None:
        if scheduler.running:
            scheduler.shutdown(wait=False)
        raise KeyboardInterrupt

    def guarded() -> None:
        try:
            job()
        except (CoilcalError, OSError) as error:
            click.echo(f"coilcal: {error}", err=True)
        except KeyboardInterrupt:
            return  # the scheduler is shut down and ends after this job

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    scheduler.add_job(
        guarded,
        "interval",
        seconds=every_s,
        next_run_time=datetime.now(UTC),
        coalesce=True,
        misfire_grace_time=None,
    )
    with suppress(
        KeyboardInterrupt, JobLookupError
    ):  # where the job itself was interrupted, it is missed afterwards
        scheduler.start()
    click.echo("coilcal: stopped", err=True)
