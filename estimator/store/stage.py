"""A hidden folder beside an output, in which it is made and from which it is moved into place as a whole.

Beside the output stands, while it is written, a hidden folder with a random name that only its user can enter:

    .NAME.0123456789abcdef53199928.coilcal/    16 random digits, and 8 that are their checksum: coilcal deletes no folder that lacks it
        coilcal          what this folder is, in a sentence
        new/NAME         what is being written
        old/NAME         what it replaces, where the disk cannot exchange two names at once

The lock of an output is the lock of the system on the file `coilcal` in it, which ends with the process, however that ends. After a kill
the folder stays without a lock. It does no harm, and the next writer of the output deletes it, or goes on from it.
"""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from estimator.errors import InvalidInput
from estimator.store.files import is_unfinished, kind_of, sync, unfinished_name, unfinished_prefix

MARK, NEW, OLD = "coilcal", "new", "old"
MARK_TEXT = "coilcal makes {name} in this folder; when no coilcal runs, the folder may be deleted.\n"
LONGEST_WAIT_S = 10.0  # for others who look at the same folder at the same instant, which takes milliseconds
LOOK_EVERY_S = 0.05
AT_FDCWD, NO_REPLACE, EXCHANGE = -100, 1, 2  # of renameat2 in Linux


class OutputBusy(InvalidInput):
    """Another program writes the same output."""

    @classmethod
    def of(cls, output: Path) -> OutputBusy:
        """The refusal of an output."""
        return cls(f"output must be written by one program at a time; another writes {output}")


@dataclass(frozen=True)
class Stage:
    """A hidden folder beside an output, held by this process through an open descriptor of its mark."""

    output: Path
    folder: Path
    descriptor: int

    @property
    def new(self) -> Path:
        """Path to write to."""
        return self.folder / NEW / self.output.name

    @property
    def old(self) -> Path:
        """Path of what is replaced, where the disk cannot exchange two names at once."""
        return self.folder / OLD / self.output.name

    @classmethod
    def begin(cls, output: Path, goes_on: bool = False, waits: bool = False) -> Stage:
        """Become the only writer of an output; what dead writers left is removed, or taken over."""
        while True:
            try:
                with _alone_in(output.parent):
                    return cls._begin(output, goes_on)
            except OutputBusy:
                if not waits:
                    raise
                time.sleep(LOOK_EVERY_S)

    @classmethod
    def _begin(cls, output: Path, goes_on: bool) -> Stage:
        dead = []
        try:
            for folder in stages(output):
                with suppress(FileNotFoundError):  # its writer has just ended
                    dead.append(cls(output, folder, os.open(folder / MARK, os.O_RDWR | os.O_NOFOLLOW)))
            if not all(_lock(stage.descriptor) for stage in dead):
                raise OutputBusy.of(output)
        except BaseException:
            for stage in dead:
                os.close(stage.descriptor)
            raise
        taken = None
        for stage in dead:
            stage._restore()
            if goes_on and taken is None and kind_of(stage.new) is not None:
                taken = stage
            else:
                stage.end()
        return taken or cls._made(output)

    @classmethod
    def _made(cls, output: Path) -> Stage:
        folder = output.with_name(unfinished_name(output.name))
        folder.mkdir(mode=0o700)
        try:
            (folder / MARK).write_text(MARK_TEXT.format(name=output.name), encoding="utf-8")
            (folder / NEW).mkdir()
            (folder / OLD).mkdir()
            descriptor = os.open(folder / MARK, os.O_RDWR | os.O_NOFOLLOW)
            if not _lock(descriptor):
                raise OutputBusy.of(output)
        except BaseException:
            _remove(folder)
            raise
        return cls(output, folder, descriptor)

    def commit(self) -> None:
        """Move what was made into place; a kill leaves the old output or the new one."""
        for path in (*self.new.rglob("*"), self.new):
            sync(path)
        if kind_of(self.output) is None:
            if not _renamed(self.new, self.output, NO_REPLACE):
                self.new.rename(self.output)
        elif not _renamed(self.new, self.output, EXCHANGE):
            self.output.rename(self.old)
            try:
                self.new.rename(self.output)
            except BaseException:
                self._restore()
                raise
        sync(self.output.parent)

    def end(self, keeps: bool = False) -> None:
        """Remove the folder and release the lock; keep what was written, if anything was, where it is to go on."""
        if not (keeps and _holds_files(self.new)):
            _remove(self.folder)
        os.close(self.descriptor)

    def _restore(self) -> None:
        """Put back an output that was moved away for a new one that never came."""
        if kind_of(self.old) is not None and kind_of(self.output) is None:
            self.old.rename(self.output)


def stages(output: Path) -> list[Path]:
    """Folders that coilcal has made beside an output to write it; those that a kill left without a whole mark are removed."""
    prefix = unfinished_prefix(output.name)
    with os.scandir(output.parent) as entries:
        names = [
            entry.name
            for entry in entries
            if entry.name.startswith(prefix)
            and len(entry.name) == len(unfinished_name(output.name))
            and is_unfinished(entry.name)
        ]
    text = MARK_TEXT.format(name=output.name).encode()
    stages = []
    for folder in map(output.with_name, names):
        with suppress(FileNotFoundError):  # its writer has just ended
            if kind_of(folder) != "a folder" or folder.stat().st_uid != os.getuid():
                continue
            mark = folder / MARK
            content = mark.read_bytes() if kind_of(mark) == "a file" else b""
            if content == text:
                stages.append(folder)
            elif text.startswith(content) and {path.name for path in folder.iterdir()} <= {MARK}:
                _remove(folder)
    return stages


def _remove(folder: Path) -> None:
    """Remove a folder that coilcal has made; the mark goes last, so that what a kill leaves is still known."""
    for part in (NEW, OLD):
        shutil.rmtree(folder / part, ignore_errors=True)
    with suppress(OSError):
        (folder / MARK).unlink(missing_ok=True)
        folder.rmdir()


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep others from beginning an output in a folder meanwhile."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        until_s = time.monotonic() + LONGEST_WAIT_S
        while not _lock(descriptor):
            if time.monotonic() > until_s:
                raise InvalidInput(
                    f"folder must be free for a moment; another program holds a lock on {folder}"
                )
            time.sleep(0.01)
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int) -> bool:
    """Take the lock of an open file or folder; False if another process has it."""
    import fcntl  # missing on Windows, where results can still be read

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _renamed(source: Path, target: Path, how: int) -> bool:
    """Rename as `renameat2` of Linux can: without replacing, or exchanging both. False where system or disk cannot."""
    try:
        call = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError):
        return False
    if call(AT_FDCWD, os.fsencode(source), AT_FDCWD, os.fsencode(target), how) == 0:
        return True
    number = ctypes.get_errno()
    if number in (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EPERM):
        return False
    raise OSError(number, os.strerror(number), str(target))


def _holds_files(path: Path) -> bool:
    return any(part.is_file() for part in (path, *path.rglob("*")))
