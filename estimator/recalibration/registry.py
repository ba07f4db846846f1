"""The registry: every calibration of a rig with its history, in one folder that survives `kill -9` at any instant.

    versions/0001/   a whole calibration, its rig.yaml and provenance.json
    current          a link to the version in use, replaced by renaming
    log.jsonl        one entry per session or rollback, in order, one line each
    told             number of entries without a pending notification

Renaming a finished version into `versions` commits it. Its log entry follows from its provenance and the link from the last entry, so the
next job that opens the folder completes the work of an interrupted one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from estimator.calibration.files import POSTERIOR_STORE, SUMMARY_FILE
from estimator.calibration.result import Calibration
from estimator.errors import CorruptStore, InvalidInput, quoted
from estimator.given_files import MOST_SETTINGS_BYTES, read_given_text
from estimator.json_files import read_json, sealed
from estimator.recalibration.log import ROLLED_BACK, Entry, Log
from estimator.rig_files.write import rig_text
from estimator.store.files import kind_of, unfinished_name, write_text, writing
from estimator.store.made import Made
from estimator.store.stage import OutputBusy
from estimator.store.staging import clear, only_writer, staged

VERSIONS, CURRENT, LOG, TOLD = "versions", "current", "log.jsonl", "told"
RIG, PROVENANCE = "rig.yaml", "provenance.json"
HISTORY = "history.html"
MADE = Made(
    "a registry",
    "",  # nothing replaces one
    (VERSIONS, CURRENT, LOG, TOLD, HISTORY),
    lambda folder: kind_of(folder / VERSIONS) == "a folder" and kind_of(folder / CURRENT) in (None, "a link"),
)


class RegistryBusy(InvalidInput):
    """Another job writes to the registry."""


class Registry:
    """The calibrations of one rig.

    Examples:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     registry = Registry(folder)
        ...     registry.versions, registry.current, registry.entries()
        ((), None, [])
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self._log = Log(self.folder / LOG)

    @property
    def versions(self) -> tuple[int, ...]:
        """Numbers of all versions, oldest first."""
        return tuple(sorted(int(path.name) for path in (self.folder / VERSIONS).glob("[0-9]*")))

    @property
    def current(self) -> int | None:
        """Number of the version in use; None before the first."""
        link = self.folder / CURRENT
        return int(link.readlink().name) if link.is_symlink() else None

    def entries(self) -> list[Entry]:
        """The log, oldest entry first.

        Raises:
            CorruptStore: A line is damaged. An incomplete last line, left by a kill, is ignored.
        """
        return self._log.read()[0]

    def calibration(self, version: int | None = None) -> Calibration:
        """One version; by default the current one.

        Raises:
            InvalidInput: There is no such version.
            CorruptStore: It is damaged.
        """
        return Calibration.load(self._path(version))

    def tree(self, version: int | None = None) -> xr.DataTree:
        """Posterior of one version in ArviZ's groups; by default of the current one."""
        return xr.open_datatree(self._path(version) / POSTERIOR_STORE, engine="zarr", consolidated=False)

    def history(self) -> xr.Dataset:
        """Median, sd and 90 % interval of every parameter of every version, in SI; NaN where a version lacks it.

        Coordinates hold the time of the readings of each version, its session and conclusion, and which parameters are derived from others.

        Raises:
            CorruptStore: The summary of a version is damaged.
        """
        made = {entry.made: entry for entry in self.entries() if entry.made is not None}
        parameters = {version: self._summary(version)["parameters"] for version in made}
        names = list(dict.fromkeys(name for numbers in parameters.values() for name in numbers))
        first = {
            name: next(numbers[name] for numbers in parameters.values() if name in numbers) for name in names
        }

        def table(select: Any) -> tuple[tuple[str, str], np.ndarray]:
            rows = [
                [select(numbers[name]) if name in numbers else np.nan for name in names]
                for numbers in parameters.values()
            ]
            return ("version", "parameter"), np.array(rows).reshape(len(made), len(names))

        return xr.Dataset(
            {
                "median": table(lambda p: p["median"]),
                "sd": table(lambda p: p["sd"]),
                "lower90": table(lambda p: p["ci90"][0]),
                "upper90": table(lambda p: p["ci90"][1]),
            },
            {
                "version": list(made),
                "parameter": names,
                "unit": ("parameter", [first[name]["unit"] for name in names]),
                "is_derived": ("parameter", [first[name]["is_derived"] for name in names]),
                "taken": ("version", [entry.taken for entry in made.values()]),
                "session": ("version", [entry.session for entry in made.values()]),
                "conclusion": ("version", [entry.conclusion for entry in made.values()]),
            },
        )

    @contextmanager
    def writing(self) -> Iterator[None]:
        """Hold the registry for one job, after completing the work of an interrupted one.

        Raises:
            RegistryBusy: Another job holds it.
            InvalidInput: The folder cannot be written, or files of somebody else have the names of a registry in it.
        """
        MADE.check_open(self.folder)
        with ExitStack() as stack:
            try:
                with writing(self.folder, "registry"):
                    stack.enter_context(only_writer(self.folder))
                    (self.folder / VERSIONS).mkdir(exist_ok=True)
                    self._complete()
            except OutputBusy:
                raise RegistryBusy(
                    f"registry must be free; another recalibration is at work on {self.folder}"
                ) from None
            yield

    def commit(
        self,
        entry: Entry,
        calibration: Calibration | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> Entry:
        """Log a conclusion, and make its calibration, if any, the current version. Only while writing.

        Args:
            entry: The conclusion.
            calibration: Calibration for a new version.
            provenance: Further origins of the calibration, for its `provenance.json`.
        Returns: The entry with its version numbers.
        """
        if calibration is None:
            entry = replace(entry, version=self.current)
        else:
            number = max(self.versions, default=0) + 1
            entry = replace(entry, version=number, made=number)
            self._save(entry, calibration, provenance or {})
        self._log.append(entry)
        self._point()
        return entry

    def tell(self, hear: Callable[[Entry], None]) -> list[Entry]:
        """Deliver pending notifications; one that is interrupted is delivered again. Only while writing.

        Args:
            hear: Called with each entry of a session.
        Returns: The delivered entries.
        """
        entries = self.entries()
        n_told = self._n_told()
        delivered = []
        for number, entry in enumerate(entries[n_told:], start=n_told + 1):
            if entry.hash:
                hear(entry)
                delivered.append(entry)
            write_text(self.folder / TOLD, f"{number}\n")
        return delivered

    def roll_back(self, version: int) -> Entry:
        """Make an earlier version current again. Only while writing.

        Raises:
            InvalidInput: There is no such version, or it is the one in use.
            CorruptStore: It is damaged.
        """
        if version == self.current:
            raise InvalidInput(
                f"version must be another than the one in use; received {version} ({self.folder})"
            )
        self.calibration(version)
        entry = Entry(
            ROLLED_BACK, f"version {self.current} replaced by version {version} on request", version=version
        )
        self._log.append(entry)
        self._point()
        return entry

    def _n_told(self) -> int:
        told = read_given_text(self.folder / TOLD, MOST_SETTINGS_BYTES, CorruptStore).strip()
        if not (told.isascii() and told.isdecimal() and len(told) < 10):
            raise CorruptStore(f"registry must count who was told; {self.folder / TOLD} holds {quoted(told)}")
        return int(told)

    def _path(self, version: int | None) -> Path:
        version = self.current if version is None else version
        if version not in self.versions:
            existing = ", ".join(map(str, self.versions)) or "none"
            raise InvalidInput(
                f"version must be one of the registry ({existing}); received {version} ({self.folder})"
            )
        return self.folder / VERSIONS / f"{version:04d}"

    def _summary(self, version: int) -> Mapping[str, Any]:
        path = self._path(version) / SUMMARY_FILE
        summary = read_json(path, fault=CorruptStore)
        if not isinstance(summary.get("parameters"), dict):
            raise CorruptStore(f"version must be whole; {path} is damaged: it holds no parameters")
        return summary

    def _save(self, entry: Entry, calibration: Calibration, provenance: Mapping[str, Any]) -> None:
        content = {
            "version": entry.made,
            "previous": self.current,
            "rig_hash": calibration.rig.hash,
            "seed": calibration.summary()["seed"],
            "versions": calibration.summary()["versions"],
            **provenance,
            "entry": asdict(entry),
        }
        with staged(self.folder / VERSIONS / f"{entry.made:04d}") as new:
            calibration.save(new)
            write_text(new / RIG, rig_text(calibration.rig))
            write_text(new / PROVENANCE, sealed(content, indent=2))

    def _point(self) -> None:
        """Link `current` to the version of the last log entry."""
        version = self.entries()[-1].version
        if version is None or version == self.current:
            return
        link = self.folder / unfinished_name(CURRENT)
        link.symlink_to(Path(VERSIONS) / f"{version:04d}")
        link.replace(self.folder / CURRENT)

    def _complete(self) -> None:
        """Remove unfinished files, and complete the log and the link of committed versions."""
        clear(self.folder / VERSIONS / f"{max(self.versions, default=0) + 1:04d}")
        entries = self._log.completed()
        if not (self.folder / TOLD).exists():  # a new registry, or one from before notifications were counted
            write_text(self.folder / TOLD, f"{len(entries)}\n")
        if self._n_told() > len(entries):
            rule = f"log must hold the {self._n_told()} entries that were told"
            cure = f"take it from a backup, or remove {self.folder / TOLD} to go on without them"
            raise CorruptStore(f"{rule}; {self.folder / LOG} holds {len(entries)}: {cure}")
        logged = {entry.made for entry in entries}
        for version in self.versions:
            if version not in logged:
                path = self.folder / VERSIONS / f"{version:04d}" / PROVENANCE
                self._log.append(Entry.of(read_json(path, fault=CorruptStore).get("entry"), str(path)))
        if self.entries():
            self._point()
