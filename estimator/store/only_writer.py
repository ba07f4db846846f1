"""A folder that one program writes at a time."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from estimator.errors import InvalidInput, reason


@contextmanager
def only_writer(folder: Path, output: Path | None = None) -> Iterator[None]:
    """Make a folder and be the only program that writes it; afterwards it is removed again if nothing was written.

    The lock leaves no file, and ends with the process, however that ends.

    Args:
        folder: What a long calculation writes.
        output: What its user knows it by, if that is something else.
    Raises:
        InvalidInput: Another program writes it, or it cannot be written.
    """
    is_new = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError as error:
        raise InvalidInput(
            f"output must be a folder that can be written; {output or folder} is not: {reason(error)}"
        ) from error
    try:
        _lock(descriptor, output or folder)
        yield
    finally:
        os.close(descriptor)
        if is_new and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _lock(descriptor: int, output: Path) -> None:
    import fcntl  # missing on Windows, where results can still be read

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InvalidInput(
            f"output must be written by one program at a time; another writes {output}"
        ) from None
