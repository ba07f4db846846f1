"""The one way in which coilcal makes a file or folder that somebody named: made aside, then moved into place as a whole.

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
from estimator.store.files import (
    is_unfinished,
    kind_of,
    real,
    sync,
    unfinished_name,
    unfinished_prefix,
    unwritable,
)
from estimator.store.made import Made, check_folder, check_outside_stores

MARK, NEW, OLD = "coilcal", "new", "old"
MARK_TEXT = "coilcal makes {name} in this folder; when no coilcal runs, the folder may be deleted.\n"
LONGEST_WAIT_S = 10.0  # for others who look at the same folder at the same instant, which takes milliseconds
LOOK_EVERY_S = 0.05
AT_FDCWD, NO_REPLACE, EXCHANGE = -100, 1, 2  # of renameat2 in Linux


WRITER = "writer"  # name that the lock of a folder has in it
OF_A_WRITE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)  # they name no file


class OutputBusy(InvalidInput):
    """Another program writes the same output."""


@contextmanager
def staged(
    output: Path | str,
    overwrite: bool = False,
    made: Made | None = None,
    *,
    goes_on: bool = False,
    waits: bool = False,
) -> Iterator[Path]:
    """Make a file or folder that takes its place when the block ends, whole or not at all.

    A block that writes nothing leaves everything as it was.

    Args:
        output: The file or folder; folders above it are made, and removed again where nothing comes of it.
        overwrite: Replace what is there.
        made: Kind of the folder, which is all that it may replace; None for a file.
        goes_on: Keep what an interrupted block has written, and go on from that.
        waits: Wait for another program that writes the output.
    Yields: Path to write to; nothing is there unless an interrupted block goes on.
    Raises:
        OutputBusy: Another program writes the output.
        InvalidInput: Something that is not to be replaced is there, or it cannot be written.
    """
    given, output = Path(output), located(output)
    check_output(given, overwrite, made)
    try:
        with _folders_above(output.parent):
            with _called(given):
                stage = _Stage.begin(output, goes_on, waits)
            try:
                yield stage.new
                if kind_of(stage.new) is not None:
                    check_output(output, overwrite, made)
                    stage.commit()
            except BaseException:
                stage.end(keeps=goes_on)
                raise
            stage.end()
    except OSError as error:
        if _is_of(output, error):
            raise unwritable(given, error) from error
        raise


@contextmanager
def only_writer(folder: Path | str) -> Iterator[None]:
    """Make a folder and be the only program that writes into it; afterwards it is removed again if nothing was written.

    Args:
        folder: What a long calculation fills bit by bit, and goes on with after an interruption.
    Raises:
        OutputBusy: Another program writes it.
        InvalidInput: It is inside a session, or cannot be written.
    """
    given, folder = Path(folder), located(folder)
    check_folder(folder)
    is_new = not folder.exists()
    try:
        with _folders_above(folder), _called(given):
            stage = _Stage.begin(folder / WRITER)
    except OSError as error:
        raise unwritable(given, error) from error
    try:
        yield
    finally:
        stage.end()
        if is_new:
            with suppress(OSError):
                folder.rmdir()


@contextmanager
def scratch_folder(place: Path) -> Iterator[Path]:
    """A path beside `place` for files that the block moves elsewhere; what it leaves there is removed."""
    stage = _Stage.begin(place)
    try:
        yield stage.new
    finally:
        stage.end()


def located(path: Path | str) -> Path:
    """The absolute path of an output, without links above it."""
    path = Path(path).absolute()
    return real(path) if path.name in ("", "..") else real(path.parent) / path.name


def clear(output: Path) -> None:
    """Remove what killed programs left beside an output that they wrote; put back what they had moved away for it.

    Raises:
        OutputBusy: A program writes the output.
    """
    _Stage.begin(output).end()


@contextmanager
def _called(output: Path) -> Iterator[None]:
    """Call an output that another program writes by the name that the user gave it."""
    try:
        yield
    except OutputBusy:
        raise OutputBusy(_busy(output)) from None


def _busy(output: Path) -> str:
    return f"output must be written by one program at a time; another writes {output}"


def write_output(output: Path | str, content: str | bytes, overwrite: bool = False) -> None:
    """Write a file that somebody named; errors as `staged`."""
    with staged(output, overwrite) as new:
        new.write_bytes(content.encode() if isinstance(content, str) else content)


def check_output(output: Path, overwrite: bool, made: Made | None = None) -> None:
    """Refuse an output that must not be made or replaced.

    Args:
        output: The file or folder.
        overwrite: Whether what coilcal made there before may be replaced.
        made: Kind of the folder; None for a file.
    Raises:
        InvalidInput: Something is there and `overwrite` is not set; it is no file, or no folder of this kind, or holds other files; the
            path leads into a session.
    """
    kind = kind_of(output)
    check_outside_stores(located(output))
    if kind is None:
        return
    if kind not in ("a file", "a folder"):
        raise InvalidInput(f"output must be a file or folder; {output} is {kind}: take another name")
    if not overwrite:
        raise InvalidInput(f"output must not exist yet, or be replaced with --overwrite; received {output}")
    if made is not None:
        made.check_replaceable(output)
    elif kind != "a file":
        raise InvalidInput(f"output must be a file; {output} is {kind}: take another name")


@dataclass(frozen=True)
class _Stage:
    """A hidden folder beside an output, held by this process through an open descriptor of its mark."""

    output: Path
    folder: Path
    descriptor: int

    @property
    def new(self) -> Path:
        return self.folder / NEW / self.output.name

    @property
    def old(self) -> Path:
        return self.folder / OLD / self.output.name

    @classmethod
    def begin(cls, output: Path, goes_on: bool = False, waits: bool = False) -> _Stage:
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
    def _begin(cls, output: Path, goes_on: bool) -> _Stage:
        dead = []
        try:
            for folder in _stages(output):
                with suppress(FileNotFoundError):  # its writer has just ended
                    dead.append(cls(output, folder, os.open(folder / MARK, os.O_RDWR | os.O_NOFOLLOW)))
            if not all(_lock(stage.descriptor) for stage in dead):
                raise OutputBusy(_busy(output))
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
    def _made(cls, output: Path) -> _Stage:
        folder = output.with_name(unfinished_name(output.name))
        folder.mkdir(mode=0o700)
        try:
            (folder / MARK).write_text(MARK_TEXT.format(name=output.name), encoding="utf-8")
            (folder / NEW).mkdir()
            (folder / OLD).mkdir()
            descriptor = os.open(folder / MARK, os.O_RDWR | os.O_NOFOLLOW)
            if not _lock(descriptor):
                raise OutputBusy(_busy(output))
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


def _stages(output: Path) -> list[Path]:
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


def _is_of(output: Path, error: OSError) -> bool:
    """Whether an error of the system is about writing an output, and not about something else that its block did."""
    if not isinstance(error.filename, str):
        return error.errno in OF_A_WRITE
    aside = str(output.with_name(unfinished_prefix(output.name)))
    return error.filename.startswith(aside) or Path(error.filename) in (output, *output.parents)


def _holds_files(path: Path) -> bool:
    return any(part.is_file() for part in (path, *path.rglob("*")))


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


@contextmanager
def _folders_above(folder: Path) -> Iterator[None]:
    """Make a folder and all above it; those that are new and empty go again if the block fails."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    for path in (folder, *folder.parents):
        if path.exists() and not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path))
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        for path in new:
            with suppress(OSError):
                path.rmdir()
        raise


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
