"""The log of a registry: one entry a line, only appended to; a kill may leave a part of the last one, which counts as not written."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from estimator.errors import CorruptStore
from estimator.given_files import MOST_RESULT_BYTES, read_given
from estimator.json_files import json_object, sealed, unsealed
from estimator.readings.clock import now
from estimator.store.files import append_text, writing

ROLLED_BACK = "rolled_back"
TORN = b'{"conclusion": "'  # how an entry begins of which a kill left a part


@dataclass(frozen=True)
class Entry:
    """One entry of the log.

    Attributes:
        conclusion: unchanged, updated, drifted, rejected or rolled_back.
        reason: Reason in one sentence, with the numbers.
        session: Path of the session; empty for a rollback.
        hash: Hash of the session, or of its files if they are damaged.
        taken: ISO time of the readings.
        concluded: ISO time of the conclusion.
        version: Version that is current from now on; None before the first.
        made: Version made from this session; None if none was.
        agrees: Whether the session agreed with the version that was current; None if they could not be compared.
        causes: Named causes, as in `diagnosis.json`.
        since: For a drift, time of the first session that no longer agreed.
        checks: Numbers behind the conclusion.
        estimate: Value and standard deviation of every parameter from this session, within the widened prior.
    """

    conclusion: str
    reason: str
    session: str = ""
    hash: str = ""
    taken: str = ""
    concluded: str = field(default_factory=now)
    version: int | None = None
    made: int | None = None
    agrees: bool | None = None
    causes: Sequence[Mapping[str, Any]] = ()
    since: str | None = None
    checks: Mapping[str, Any] = field(default_factory=dict)
    estimate: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @classmethod
    def of_line(cls, line: bytes, origin: str) -> Entry:
        """The entry in a line of the log; one of version 0.2 has no seal.

        Args:
            line: The line, without its end.
            origin: Its place, for messages.
        Raises:
            CorruptStore: It is no entry, or does not match its seal.
        """
        return cls.of(unsealed(json_object(line, origin, CorruptStore), origin, CorruptStore), origin)

    @classmethod
    def of(cls, content: object, origin: str) -> Entry:
        """The entry that JSON holds; `origin` names its place in messages.

        Raises:
            CorruptStore: It is another object.
        """
        keys = {each.name for each in fields(cls)}
        if not isinstance(content, dict) or not {"conclusion", "reason"} <= set(content) <= keys:
            raise CorruptStore(f"entry must have the keys that coilcal writes; {origin} has others")
        entry = cls(**content)
        words = (entry.conclusion, entry.reason, entry.session, entry.hash, entry.taken, entry.concluded)
        if not all(isinstance(word, str) for word in words) or not all(
            number is None or type(number) is int for number in (entry.version, entry.made)
        ):
            raise CorruptStore(f"entry must be as coilcal writes it; {origin} is another")
        return entry

    def line(self) -> str:
        """The entry as one line of JSON."""
        return json.dumps(asdict(self), allow_nan=False)


@dataclass(frozen=True)
class Log:
    """The log at a path, which need not exist."""

    path: Path

    def read(self) -> tuple[list[Entry], int]:
        """All entries, and the length in bytes of their lines without the end of the last one.

        Raises:
            CorruptStore: A line is damaged. An incomplete last line, left by a kill, is ignored.
        """
        if not self.path.exists():
            return [], 0
        *lines, last = read_given(self.path, MOST_RESULT_BYTES, CorruptStore).split(b"\n")
        entries = [Entry.of_line(line, f"{self.path}, line {n}") for n, line in enumerate(lines, start=1)]
        # A line that lacks only its end is an entry, which was reported as written.
        with suppress(CorruptStore):
            entries.append(Entry.of_line(last, str(self.path)))
            lines.append(last)
            last = b""
        if not _is_torn(last):
            raise CorruptStore(f"log must end in an entry, or in part of one; {self.path} does not")
        return entries, len(b"\n".join(lines))

    def append(self, entry: Entry) -> None:
        """Add an entry; once this returns, it is on disk.

        Raises:
            InvalidInput: It cannot be written.
        """
        with writing(self.path, "registry"):
            append_text(self.path, sealed(asdict(entry)))

    def completed(self) -> list[Entry]:
        """All entries, after what follows the last whole one was cut off and its line was ended."""
        entries, end = self.read()  # checked before anything is cut off
        if not entries and self.path.exists():
            os.truncate(self.path, 0)
        elif entries:
            with self.path.open("r+b") as file:
                file.seek(end)
                if file.read() != b"\n":
                    file.seek(end)
                    file.write(b"\n")
                    file.truncate()
                    file.flush()
                    os.fsync(file.fileno())
        return entries


def _is_torn(line: bytes) -> bool:
    """Whether a kill may have left this of an entry: its beginning, and not all of it with something behind."""
    if not (line.startswith(TORN) or TORN.startswith(line)) or not line.isascii() or b"\0" in line:
        return False
    try:
        json.JSONDecoder().raw_decode(line.decode())
    except ValueError:
        return True
    return False
