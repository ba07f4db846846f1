"""Repeats a command at intervals, where no cron, systemd timer or Kubernetes does so."""

from __future__ import annotations

import re
import signal
from collections.abc import Callable
from datetime import UTC, datetime
from queue import Empty, SimpleQueue

import click
from apscheduler.schedulers.background import BackgroundScheduler

from estimator.cli.interruption import interrupted_by
from estimator.errors import CoilcalError, InvalidInput, quoted

INTERVAL = re.compile(r"(?P<number>\d+(\.\d+)?)(?P<unit>[smhd])")
SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
# A signal that comes in the instant before waiting begins is only seen when the wait ends
LONGEST_WAIT_S = 1.0


def interval_s(text: str) -> float:
    """Seconds of an interval such as 6h.

    Raises:
        InvalidInput: The text has another form, or the interval is shorter than a second.
    Examples:
        >>> interval_s("6h"), interval_s("1.5m")
        (21600.0, 90.0)
    """
    match = INTERVAL.fullmatch(text)
    seconds = float(match["number"]) * SECONDS[match["unit"]] if match else 0.0
    if seconds < 1.0:
        raise InvalidInput(f"--every must be a time such as 30s, 15m, 6h or 1d; received {quoted(text)}")
    return seconds


def keep_running(job: Callable[[], object], every_s: float) -> None:
    """Run a job now and at every interval until SIGTERM or Ctrl-C. These interrupt the job, which must be safe to interrupt at any instant.

    Intervals that end while the job runs are made up for by one run after it. A fault that coilcal or the system can explain is printed
    and does not end the loop: an inbox that is not mounted now may be there the next time.
    """
    due: SimpleQueue[None] = SimpleQueue()  # unlike an Event, a signal may interrupt its wait anywhere
    scheduler = BackgroundScheduler(timezone=UTC)
    scheduler.add_job(
        lambda: due.put(None) if due.empty() else None,
        "interval",
        seconds=every_s,
        next_run_time=datetime.now(UTC),
        misfire_grace_time=None,
    )

    interrupted_by(signal.SIGTERM, signal.SIGINT)
    try:
        scheduler.start()
        # The job runs in this thread, where signals arrive; the scheduler's own thread only says when it is due.
        while True:
            try:
                due.get(timeout=LONGEST_WAIT_S)
                job()
            except Empty:
                continue
            except (CoilcalError, OSError) as error:
                click.echo(f"coilcal: {error}", err=True)
    except KeyboardInterrupt:
        click.echo("coilcal: stopped", err=True)
    finally:
        if scheduler.running:
            scheduler.shutdown(wait=False)
