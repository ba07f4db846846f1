"""Reads a session while another process writes it: every entry once and in order, however late the reader is.

The journal on disk is the buffer between the two, so the writer never waits for a reader.
"""

from __future__ import annotations

from pathlib import Path

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.state import rig_from_state
from estimator.store.growing import GROWING
from estimator.store.journal import Entry, parsed_lines
from estimator.store.made import JOURNAL
from estimator.store.session import is_growing


class Follower:
    """A reader of a journal that remembers its position.

    Attributes:
        header: First entry of the journal.
        n_read: Number of entries returned so far.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL
        self._end, self._n_lines, self.n_read = 0, 0, 0
        if not self._path.is_file():
            raise InvalidInput(
                f"session must be one that coilcal acquire writes or wrote; received {folder}, which has no journal"
            )
        self._unread = self._new_entries()
        if not self._unread or self._unread[0].get("kind") != GROWING:
            raise InvalidInput(f"session must be of kind {GROWING!r}; {folder} is not")
        self.header = self._unread.pop(0)

    @property
    def rig(self) -> Rig:
        """The rig that is measured."""
        return rig_from_state(self.header["rig"], f"rig inside {self._path.parent}")

    @property
    def has_ended(self) -> bool:
        """Whether the session is complete; check it before calling `entries`, or the last ones may be missed."""
        return not is_growing(self._path.parent)

    def entries(self) -> list[Entry]:
        """All entries since the last call.

        Raises:
            CorruptStore: A line is damaged.
        """
        entries = [*self._unread, *self._new_entries()]
        self._unread = []
        self.n_read += len(entries)
        return entries

    def _new_entries(self) -> list[Entry]:
        with self._path.open("rb") as file:
            file.seek(self._end)
            entries, size = parsed_lines(file.read(), self._n_lines, self._path)
        self._end += size
        self._n_lines += len(entries)
        return entries
