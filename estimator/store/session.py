"""A session: the readings of one visit to one rig, in a zarr v3 group that plain xarray opens.

Every chunk has a crc32c. The group has a SHA-256 over all arrays and attributes, because zarr silently reads a missing chunk as fill
values. The rig's YAML and its values are stored too, so a session is self-contained.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from estimator.errors import CoilcalError, CorruptStore, InvalidInput, quoted
from estimator.glance import Shown
from estimator.readings.clock import now
from estimator.readings.observations import Observations
from estimator.rig.bodies import Body, Mover
from estimator.rig.rig import Rig
from estimator.rig_files.devices import without_devices
from estimator.rig_files.state import rig_from_state, rig_state
from estimator.rig_files.write import rig_text
from estimator.store.admission import admit, admit_readings
from estimator.store.arrays import ARRAYS, digest, observation_arrays, observations_from
from estimator.store.files import sync, writing
from estimator.store.growing import GROWING, observations_of
from estimator.store.journal import read_journal, unwritten
from estimator.store.made import END, GROUP, JOURNAL, Made, arrays_of, has_journal, holds
from estimator.store.staging import scratch_folder, staged
from estimator.store.tree import read_tree, write_arrays

SCHEMA_VERSION = 1
KIND = "coilcal session"
SEALING = "arrays"  # scratch folder in which a journal is turned into arrays


@dataclass(frozen=True)
class StoredRig:
    """A rig that was read from a store, with its state there."""

    rig: Rig
    state: Mapping[str, Any]

    @classmethod
    def of(cls, state: Mapping[str, Any], file: str) -> StoredRig:
        """Read the rig; `file` names its origin in messages."""
        return cls(rig_from_state(state, file), state)


@dataclass(frozen=True, repr=False)
class Session(Shown):
    """Readings with the rig on which they were taken.

    Attributes:
        rig: The rig as its YAML file describes it.
        observations: The readings.
        source: Origin of the readings, in words.
        created: ISO date and time at which the readings were taken, as far as that is known, else at which the session was made.
        truth: Parameter values of a simulation, by name; empty for measured data.
        stored_rig: The rig with its state in the store that it was read from, which the hash covers; None for a new session.
    """

    rig: Rig
    observations: Observations
    source: str
    created: str = field(default_factory=now)
    truth: Mapping[str, float] = field(default_factory=dict)
    stored_rig: StoredRig | None = field(default=None, repr=False, compare=False)

    @classmethod
    def from_dataframe(
        cls,
        frame: Any,
        rig: Rig,
        *,
        columns: Mapping[str, str] | None = None,
        constants: Mapping[str, float] | None = None,
        validation: float = 0.2,
        seed: int = 0,
        source: str = "data frame",
    ) -> Session:
        """Readings of a data frame of pandas or polars, read and checked as `coilcal import` does.

        Args:
            frame: A row for each reading, with names of columns as in a file, such as `Bx [mT]`; a mapping of columns will do.
            rig: The rig of the readings.
            columns: What a column is, where its name does not tell: `{"Probe 1": "Bx_mT"}`; "-" leaves one out.
            constants: Columns that the frame lacks, the same in all rows: `{"coil1_current_A": 3.0}`.
            validation: Share of the readings kept out of the fit.
            seed: Decides which.
            source: Origin of the readings, for messages and reports.
        Raises:
            InvalidInput: A column is missing or cannot be read, or the readings cannot be fitted.
        Examples:
            >>> import numpy as np
            >>> rig = Rig.coil(0.05, 30, 12, wire_radius_m=0.0004)
            >>> places = {f"stage_{axis}_mm": np.linspace(0, 20, 8) for axis in "xyz"}
            >>> fields = {f"B{axis} [mT]": np.linspace(1, 3, 8) for axis in "xyz"}
            >>> frame = {**places, **fields}  # or a pandas.DataFrame
            >>> session = Session.from_dataframe(frame, rig, constants={"coil1_current_A": 1.0}, validation=0)
            >>> len(session.observations)
            8
        """
        from estimator.store.importers.checked import checked
        from estimator.store.importers.forms.frames import readings_of_frame

        readings = readings_of_frame(frame, rig, dict(columns or {}), dict(constants or {}), source)
        observations = checked(rig, readings.observations, source, validation, seed).observations
        return cls(rig, observations, source, readings.created)

    @property
    def hash(self) -> str:
        """SHA-256 over readings and rig without its devices; the same readings always give the same hash."""
        state = self._stored_state or {"text": rig_text(self.rig)}
        text = without_devices(state["text"])
        return digest(observation_arrays(self.observations), {**state, "text": text})

    @property
    def _stored_state(self) -> Mapping[str, Any] | None:
        """State of the rig as it was read; None where it was not read from a store, or was replaced since."""
        stored = self.stored_rig
        return stored.state if stored is not None and stored.rig == self.rig else None

    def check_rig(self, rig: Rig) -> None:
        """Refuse a rig whose coils, sensors and movers are not those of the session, in the same order.

        Raises:
            InvalidInput: The names of coils, sensors or movers differ, or the motion of a mover does.
        """
        for kind in ("coils", "sensors", "movers"):
            expected, received = ([_described(body) for body in getattr(r, kind)] for r in (self.rig, rig))
            if expected != received:
                raise InvalidInput(
                    f"{kind} of the rig must be those of the session ({', '.join(expected) or 'none'}); "
                    f"received {', '.join(received) or 'none'} (rig {rig.name!r})"
                )

    def save(self, path: Path, overwrite: bool = False) -> None:
        """Write the session, whole or not at all. What is written can be opened again.

        Raises:
            InvalidInput: The path exists and `overwrite` is not set, a process is measuring into it, it cannot be written, or
                `load_session` would refuse the readings.
        """
        path = path.absolute()
        with unwritten(path), staged(path, overwrite, SESSION) as new:
            try:
                self._write(new)
                admit(new, "session")
            except CorruptStore as fault:  # which `load_session` would raise
                raise InvalidInput(str(fault).replace(str(new), str(path))) from fault

    def _write(self, path: Path) -> None:
        import zarr  # a fifth of a second, which only the arrays of a session need

        attributes: dict[str, Any] = {
            "kind": KIND,
            "schema_version": SCHEMA_VERSION,
            "created": self.created,
            "source": self.source,
            "truth": dict(self.truth),
            "rig": self._stored_state or rig_state(self.rig),
            "coil": [coil.name for coil in self.rig.coils],
            "sensor": [sensor.name for sensor in self.rig.sensors],
        }
        arrays = observation_arrays(self.observations)
        admit_readings({name: data for name, (_, data) in arrays.items()}, self.rig, self.source)
        if (
            self.observations.line is not None
        ):  # says where readings stood, not what they are: no part of their hash
            arrays["line"] = ("reading",), self.observations.line.numpy()
        _provenance(attributes, path)
        group = zarr.open_group(path, mode="w", zarr_format=3)
        write_arrays(group, arrays)
        group.attrs.update({**attributes, "sha256": digest(arrays, attributes)})


def check_session(session: object) -> None:
    """Refuse what is no session, such as its path.

    Raises:
        InvalidInput: It is none.
    """
    if not isinstance(session, Session):
        raise InvalidInput(
            f"session must be a Session, as load_session('session.zarr') gives; received {quoted(session)}"
        )


def load_session(path: Path | str) -> Session:
    """Open a session and check every byte of it.

    Raises:
        InvalidInput: There is no session at this path.
        CorruptStore: A file is missing, truncated or altered, or the schema has another version.
    """
    path = Path(path)
    if is_growing(path):
        return _from_journal(path)
    if not (path / GROUP).is_file():
        raise InvalidInput(
            f"session must be a folder that coilcal import, simulate or acquire wrote; received {path}"
        )
    admit(path, "session")
    with _readable(path):
        top = read_tree(path)["/"]
        attributes, arrays = top.attributes, top.variables
        _check_kind(attributes, path)
        stored_digest = attributes.pop("sha256")
        if digest(arrays, attributes) != stored_digest:
            raise CorruptStore(f"session must match its SHA-256; {path} was altered or lost a chunk")
        stored = StoredRig.of(attributes["rig"], f"rig inside {path}")
        readings = {name: data for name, (_, data) in arrays.items()}
        admit_readings(readings, stored.rig, str(path))
        observations = observations_from(readings, stored.rig)
        provenance = _provenance(attributes, path)
    return Session(stored.rig, observations, *provenance, stored_rig=stored)


def is_growing(path: Path) -> bool:
    """Whether the session at this path is still being measured, or was interrupted."""
    return (path / JOURNAL).is_file() and not (path / GROUP).is_file()


def seal(path: Path) -> Session:
    """Turn the journal of a completely measured session into arrays; the journal stays beside them.

    Raises:
        InvalidInput: The arrays cannot be written; the journal is unchanged.
        CorruptStore: The journal is damaged.
    """
    session = _from_journal(path)
    with writing(path, "session"), scratch_folder(path / SEALING) as arrays:
        session._write(arrays)
        for file in arrays.rglob("*"):
            sync(file)
        # The group's own file makes the folder a session, so it is moved last: after a kill before that, it is still a journal.
        for part in sorted(arrays.iterdir(), key=lambda part: part.name == GROUP):
            if part.name != GROUP:
                shutil.rmtree(path / part.name, ignore_errors=True)
            part.rename(path / part.name)
        sync(path)
    return session


def remove_session(path: Path) -> None:
    """Delete a session that is to be measured anew.

    Raises:
        InvalidInput: The path holds no session, a process writes it, or it cannot be deleted.
    """
    SESSION.check_replaceable(path)
    with writing(path), unwritten(path):
        shutil.rmtree(path)


def _from_journal(path: Path) -> Session:
    header, entries = read_journal(path)
    if header.get("kind") != GROWING or header.get("schema_version") != SCHEMA_VERSION:
        raise CorruptStore(f"session must be of kind {GROWING!r}, version {SCHEMA_VERSION}; {path} is not")
    with _readable(path):  # lines may have their checksums, but another shape
        stored = StoredRig.of(header["rig"], f"rig inside {path}")
        observations = observations_of(entries, stored.rig)
        arrays = observation_arrays(observations)
        admit_readings({name: data for name, (_, data) in arrays.items()}, stored.rig, str(path))
        provenance = _provenance(header, path)
    return Session(stored.rig, observations, *provenance, stored_rig=stored)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Raise `CorruptStore` for what damaged bytes raise: errors of nearly any type in zarr, JSON and NumPy."""
    try:
        yield
    except CoilcalError:
        raise
    except Exception as error:
        words = f"session must be readable; {path} is damaged: {type(error).__name__} {error}"
        raise CorruptStore(words) from error


def is_session(path: Path) -> bool:
    """Whether a session is at this path, sealed or growing."""
    return is_growing(path) or holds(path / GROUP, KIND)


SESSION = Made(
    "a session",
    rf"{arrays_of(ARRAYS)}|{JOURNAL}|delivery\.json|{END}",
    (GROUP, JOURNAL),
    lambda folder: has_journal(folder) or holds(folder / GROUP, KIND),
)


def _described(body: Body | Mover) -> str:
    return f"{body.name} ({body.motion})" if isinstance(body, Mover) else body.name


def _check_kind(attributes: Mapping[str, Any], path: Path) -> None:
    if attributes.get("kind") != KIND:
        raise InvalidInput(
            f"session must be of kind {KIND!r}; received {quoted(attributes.get('kind'))} ({path})"
        )
    if attributes.get("schema_version") != SCHEMA_VERSION:
        raise CorruptStore(
            f"session schema_version must be {SCHEMA_VERSION}; received {quoted(attributes.get('schema_version'))} ({path})"
        )


def _provenance(attributes: Mapping[str, Any], path: Path) -> tuple[str, str, Mapping[str, float]]:
    """Source, time and truth of a session, as `Session` takes them."""
    source, created, truth = attributes["source"], attributes["created"], attributes.get("truth", {})
    if not (isinstance(source, str) and isinstance(created, str)):
        raise CorruptStore(f"session must tell its source and time in words; {path} does not")
    if not all(isinstance(value, int | float) and math.isfinite(value) for value in truth.values()):
        raise CorruptStore(f"session must tell its truth in finite numbers; {path} does not")
    return source, created, truth
