"""Reads a session while another process writes it: every record once and in order, however late the reader is.

The journal is the buffer between the two. The writer never waits for a reader, and what the reader has not taken yet stays on the disk.
"""

from __future__ import annotations

from pathlib import Path

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.state import rig_from_state
from estimator.store.growing import GROWING
from estimator.store.journal import JOURNAL, Record, parsed_lines
from estimator.store.session import is_growing


class Follower:
    """A reader that remembers how far it is.

    Attributes:
        header: First record of the journal.
        n_read: Records that were handed out.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL
        self._end, self._n_lines, self.n_read = 0, 0, 0
        if not self._path.is_file():
            raise InvalidInput(
                f"session must be one that coilcal acquire writes or wrote; received {folder}, which has no journal"
            )
        self._waiting = self._more()
        if not self._waiting or self._waiting[0].get("kind") != GROWING:
            raise InvalidInput(f"session must be of kind {GROWING!r}; {folder} is not")
        self.header = self._waiting.pop(0)

    @property
    def rig(self) -> Rig:
        """The rig that is measured."""
        return rig_from_state(self.header["rig"], f"rig inside {self._path.parent}")

    @property
    def has_ended(self) -> bool:
        """Whether no more will come; ask before `records`, or the last ones may be missed."""
        return not is_growing(self._path.parent)

    def records(self) -> list[Record]:
        """All records that were not handed out yet.

        Raises:
            CorruptStore: A line is damaged.
        """
        taken = [*self._waiting, *self._more()]
        self._waiting = []
        self.n_read += len(taken)
        return taken

    def _more(self) -> list[Record]:
        with self._path.open("rb") as file:
            file.seek(self._end)
            entries, size = parsed_lines(file.read(), self._n_lines, self._path)
        self._end += size
        self._n_lines += len(entries)
        return entries
