"""Lets a process with deadlines run ahead of others, if the system permits it."""

from __future__ import annotations

import logging
import os

_LOG = logging.getLogger(__name__)


def run_ahead() -> None:
    """Request the lowest real-time priority: ahead of every ordinary process, behind all other real-time ones.

    An arm stops if its watchdog was not kicked for 0.2 s, and an ordinary process may wait that long on a busy computer. The process must
    sleep in each of its loops. Permission is `CAP_SYS_NICE` or a limit `rtprio` (man 7 sched). Without it the priority stays as it was,
    and an arm may stop needlessly.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR)))
    except OSError as error:
        _LOG.info("process %d runs at ordinary priority: %s", os.getpid(), error)
