"""Lets a process that must not be late run ahead of others, where the system permits it."""

from __future__ import annotations

import logging
import os

_LOG = logging.getLogger(__name__)


def run_ahead() -> None:
    """Ask for the lowest of the real-time priorities: ahead of every ordinary process, behind all else that is real-time.

    An arm stops when its watchdog was not kicked for 0.2 s, and on a computer whose processors are all busy an ordinary process may wait
    that long. The process must sleep in each of its loops. Permission is `CAP_SYS_NICE` or a limit `rtprio` (man 7 sched); without, it is
    as before, and an arm stops where it need not have.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))
    except OSError as error:
        _LOG.info("process %d runs at ordinary priority: %s", os.getpid(), error)
