"""What coilcal made, recognised by what stands in it: only that is replaced or deleted."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from estimator.errors import InvalidInput, listed
from estimator.store.files import is_unfinished, kind_of

MOST_NAMED = 3
ZARR_PARTIAL = re.compile(r".+\.[0-9a-f]{32}\.partial")  # of zarr, while it replaces a chunk
JOURNAL, GROUP = "journal.jsonl", "zarr.json"
END = "end.json"  # why a session ended whose stops were chosen while it was measured
FIRST_LINE = re.compile(rb'[0-9a-f]{8} \{"n": 0\b')


def arrays_of(names: str) -> str:
    """Paths of the files of arrays in a zarr 3 group, as a regular expression; `names` is one, too."""
    return rf"zarr\.json|(?:{names})/(?:zarr\.json|c(?:/\d+)*/?)"


@dataclass(frozen=True)
class Made:
    """A kind of folder that coilcal makes.

    Attributes:
        words: Such as `a session`.
        files: Paths in it, as a regular expression; a path of an empty folder ends with a slash.
        names: What stands at its top.
        is_one: Whether a folder is of this kind, whatever else is in it.
    """

    words: str
    files: str
    names: tuple[str, ...]
    is_one: Callable[[Path], bool]

    def check_replaceable(self, folder: Path) -> None:
        """Refuse a folder that is of another kind, or holds anything that coilcal did not write.

        Raises:
            InvalidInput: It is, or does; the message names what it holds.
        """
        if kind_of(folder) != "a folder" or not self.is_one(folder):
            raise InvalidInput(f"only {self.words} is replaced by {self.words}; {folder} is something else")
        self.check_own(folder)

    def check_own(self, folder: Path) -> None:
        """Refuse a folder that holds anything that coilcal did not write.

        Raises:
            InvalidInput: It does; the message names what it holds.
        """
        if foreign := sorted(self._foreign(folder)):
            raise InvalidInput(
                f"what is replaced must hold nothing but {self.words}; {folder} also holds "
                f"{listed(foreign[:MOST_NAMED], len(foreign))}, which coilcal did not write: move it away first"
            )

    def check_open(self, folder: Path) -> None:
        """Refuse to write into a folder in which files of somebody else have the names of this kind.

        Raises:
            InvalidInput: It is of another kind and holds such a name.
        """
        if not self.is_one(folder):
            for name in self.names:
                if kind_of(folder / name) is not None:
                    raise InvalidInput(
                        f"output must be {self.words}, or a folder without the names of one; {folder} holds {name}, "
                        "which coilcal did not write: take another folder"
                    )

    def _foreign(self, folder: Path) -> Iterator[str]:
        """Paths in a folder that this kind does not have."""
        pattern = re.compile(self.files)
        for place, folders, files in os.walk(folder):
            here = Path(place)
            for name in [*folders, *files]:
                path = here / name
                known = path.relative_to(folder).as_posix()
                kind = kind_of(path)
                if any(map(is_unfinished, Path(known).parts)):
                    is_own = kind in ("a file", "a folder")
                elif kind == "a folder":
                    is_own = any(path.iterdir()) or pattern.fullmatch(known + "/") is not None
                else:
                    is_own = kind == "a file" and (
                        pattern.fullmatch(known) is not None or ZARR_PARTIAL.fullmatch(name) is not None
                    )
                if not is_own:
                    yield known


def holds(file: Path, *words: str) -> bool:
    """Whether a file is there and holds all of these words."""
    if kind_of(file) != "a file":
        return False
    content = file.read_bytes()
    return all(word.encode() in content for word in words)


def check_outside_stores(path: Path) -> None:
    """Refuse an output inside a session, or inside another store of arrays.

    Raises:
        InvalidInput: A folder above the path is one.
    """
    _check_no_store(path, *path.parents)


def _check_no_store(output: Path, *folders: Path) -> None:
    for folder in folders:
        if (folder / GROUP).is_file() or has_journal(folder):
            raise InvalidInput(
                f"output must stand outside of sessions and other stores; {output} is inside {folder}"
            )


def check_folder(folder: Path) -> None:
    """Refuse to write files into a session, into another store of arrays, or inside of one.

    Raises:
        InvalidInput: The folder is one, or is inside of one.
    """
    _check_no_store(folder, folder, *folder.parents)


def has_journal(folder: Path) -> bool:
    """Whether a folder holds a journal that coilcal began."""
    file = folder / JOURNAL
    if not file.is_file():
        return False
    with file.open("rb") as stream:
        return FIRST_LINE.match(stream.read(40)) is not None
