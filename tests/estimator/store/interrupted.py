"""Kills a program, or fills its disk, at each operation on files that it makes."""

from __future__ import annotations

import errno
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

CHANGES = (
    "os.mkdir",
    "os.rename",
    "os.remove",
    "os.rmdir",
    "os.truncate",
    "ctypes.dlsym",
    "os.link",
    "os.symlink",
)
DEVICE = re.compile(r"/dev/(?!shm/)")  # in /dev/shm stand files of tests
KILLED = 9
ASIDE = re.compile(r"\.coilcal/new/[^/]+/.")  # where a whole store is written


def is_change(event: str, arguments: tuple[Any, ...]) -> bool:
    """Whether an audit event is about to change a file; renaming by `renameat2` shows as the look-up of its name."""
    if event == "open":
        flags = arguments[2]
        return (
            isinstance(flags, int)
            and bool(flags & (os.O_WRONLY | os.O_RDWR))
            and not DEVICE.match(str(arguments[0]))
        )
    return event in CHANGES


def is_inside_a_store(event: str, name: str) -> bool:
    """Whether a change is one of many alike in a store that is written aside or deleted; deletion names files below an open folder."""
    return bool(ASIDE.search(name)) or (event in ("os.remove", "os.rmdir") and "/" not in name)


def killed_at_each_operation(work: Callable[[], object], one_in: int = 1, most: int = 1000) -> Iterator[int]:
    """Run `work` in a process that ends before its first, second, ... change of a file, until one runs to its end.

    Args:
        work: What is killed.
        one_in: Of so many changes inside a store that is written aside or deleted, one is tried.
        most: Changes that it may make.
    """
    for n in range(most):
        child = os.fork()
        if child == 0:
            left, n_inside = n, 0

            def hook(event: str, arguments: tuple[Any, ...]) -> None:
                nonlocal left, n_inside
                if is_change(event, arguments):
                    if is_inside_a_store(event, str(arguments[0])):
                        n_inside += 1
                        if n_inside % one_in != 1 % one_in:
                            return
                    if left == 0:
                        os._exit(KILLED)
                    left -= 1

            sys.addaudithook(hook)
            try:
                work()
            except BaseException:
                os._exit(1)
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        assert code in (0, KILLED)
        yield n
        if code == 0:
            assert n > 0, "nothing was changed"
            return
    raise AssertionError("it never ran to its end")


class _Disk:
    """What the hook of this process looks at; a hook cannot be taken away again."""

    left: int | None = None
    was_full = False
    has_hook = False


@contextmanager
def full_disk(n: int) -> Iterator[_Disk]:
    """A disk that takes `n` changes of files and refuses each one that follows, but deletes."""

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if (
            _Disk.left is None
            or not is_change(event, arguments)
            or event in ("os.remove", "os.rmdir", "ctypes.dlsym")
        ):
            return
        if _Disk.left == 0:
            _Disk.was_full = True
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        _Disk.left -= 1

    if not _Disk.has_hook:
        sys.addaudithook(hook)
        _Disk.has_hook = True
    _Disk.left, _Disk.was_full = n, False
    try:
        yield _Disk()
    finally:
        _Disk.left = None
