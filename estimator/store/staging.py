"""The one way in which coilcal makes a file or folder that somebody named: made aside, then moved into place as a whole."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from estimator.errors import InvalidInput
from estimator.store.files import kind_of, real, unfinished_prefix, unwritable, writing
from estimator.store.made import Made, check_folder, check_outside_stores
from estimator.store.stage import OutputBusy, Stage

WRITER = "writer"  # name that the lock of a folder has in it
OF_A_WRITE = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS)  # they name no file


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
                stage = Stage.begin(output, goes_on, waits)
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
    with writing(given), _folders_above(folder), _called(given):
        stage = Stage.begin(folder / WRITER)
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
    stage = Stage.begin(place)
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
    Stage.begin(output).end()


@contextmanager
def _called(output: Path) -> Iterator[None]:
    """Call an output that another program writes by the name that the user gave it."""
    try:
        yield
    except OutputBusy:
        raise OutputBusy.of(output) from None


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


def _is_of(output: Path, error: OSError) -> bool:
    """Whether an error of the system is about writing an output, and not about something else that its block did."""
    if not isinstance(error.filename, str):
        return error.errno in OF_A_WRITE
    aside = str(output.with_name(unfinished_prefix(output.name)))
    return error.filename.startswith(aside) or Path(error.filename) in (output, *output.parents)


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
