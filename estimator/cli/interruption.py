"""Ctrl-C interrupts the program once, so that it can end in order; further ones change nothing."""

from __future__ import annotations

import atexit
import signal
import sys
import threading
import time

PATIENCE_S = 30.0  # after which another Ctrl-C interrupts a program that has not ended


class _Last:
    """When Ctrl-C interrupted the program last."""

    interrupted_s: float | None = None


def interrupt(*_: object) -> None:
    """Handler of signals that end the program: raises KeyboardInterrupt, and then no other one for a while."""
    now_s = time.monotonic()
    if _Last.interrupted_s is None or now_s - _Last.interrupted_s > PATIENCE_S:
        _Last.interrupted_s = now_s
        raise KeyboardInterrupt


def interrupted_by(*numbers: signal.Signals) -> None:
    """Let each of these signals interrupt what begins now, once."""
    _Last.interrupted_s = None
    for number in numbers:
        signal.signal(number, interrupt)


def interrupt_once() -> None:
    """Let Ctrl-C interrupt the program once, until its end; for the main thread of a program of its own."""
    if threading.current_thread() is not threading.main_thread():
        return
    _Last.interrupted_s = None
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
        sys.unraisablehook = _raised_again
        # Python takes its own handlers away before it ends, but leaves a signal that is ignored so.
        atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)


def ignore_interruptions() -> None:
    """Let nothing disturb the end of the program."""
    _Last.interrupted_s = time.monotonic()


def _raised_again(fault: sys.UnraisableHookArgs) -> None:
    """Raise an interruption again that came where Python cannot raise it, as in a destructor."""
    if fault.exc_type is KeyboardInterrupt:
        _Last.interrupted_s = None
        signal.raise_signal(signal.SIGINT)
    else:
        sys.__unraisablehook__(fault)
