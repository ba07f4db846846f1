"""Copies the data folder of a service into one file while the service runs, and makes a data folder of such a file.

The database is copied first, as it is at one instant; what its rows name was on disk before they were written. Then come the folders. A
file that marks others as complete is copied before them: where it is there, they are whole, and where it is not, the folder is one that a
kill would have left, with which a service goes on. Journals only grow, so readings that were acknowledged before the start are in the copy.
The key that signs logins is not copied: whoever reads a backup could forge logins with it, and without it users log in once more.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import shutil
import sqlite3
import stat
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

from estimator.errors import CoilcalError, CorruptStore, InvalidInput, reason
from estimator.json_files import json_object
from estimator.service.core import DATABASE, SESSIONS, UPLOADS
from estimator.service.database import check_database, explained
from estimator.store.files import is_unfinished, sync
from estimator.store.made import JOURNAL
from estimator.store.session import is_growing

KIND, SCHEMA_VERSION = "coilcal backup", 1
MANIFEST, CHECKSUMS = "manifest.json", "checksums.json"
FOLDER = "data"
MARKS = ("result.json", "summary.json", "diagnosis.json", "zarr.json")
# What a file that is none, or one that was made to do harm, raises while it is unpacked.
UNREADABLE = (
    tarfile.TarError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    OverflowError,
    RecursionError,
    FileExistsError,
    IsADirectoryError,
    NotADirectoryError,
)


def backup(data: Path, file: Path) -> dict[str, Any]:
    """Copy a data folder into a file; the service that uses it may run.

    Args:
        data: The data folder.
        file: A tar file to write, which only its owner can read; whole or not at all.
    Returns: `file`, `files` (their number) and `bytes`.
    Raises:
        InvalidInput: There is no data folder, its database is that of another program, the file exists, or it cannot be written.
        CorruptStore: The database is damaged.
    """
    data = data.absolute()
    if not (data / DATABASE).is_file():
        raise InvalidInput(f"data must be the folder of a service; {data} has no {DATABASE}")
    check_database(data / DATABASE)
    if os.path.lexists(file):
        raise InvalidInput(f"output must not exist yet; received {file}")
    folder = file.absolute().parent
    partial: Path | None = None
    try:
        descriptor, name = tempfile.mkstemp(dir=folder, prefix=f".{file.name}-")  # for its owner only
        partial = Path(name)
        with os.fdopen(descriptor, "wb") as stream:
            n_files = _write(data, stream, folder)
            stream.flush()
            os.fsync(stream.fileno())
        partial.rename(file)
        sync(folder)
    except OSError as error:
        raise InvalidInput(f"output must be writable; {file} is not: {reason(error)}") from error
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)
    return {"file": str(file), "files": n_files, "bytes": file.stat().st_size}


def restore(file: Path, data: Path) -> dict[str, Any]:
    """Make a data folder of a backup, whole or not at all.

    Args:
        file: What `backup` wrote.
        data: The folder to make; nothing may be there.
    Returns: `data`, `files` (their number) and `created` (time of the backup).
    Raises:
        InvalidInput: Something is at `data`, or it cannot be written; or the file cannot be read.
        CorruptStore: The file is no backup, is damaged, holds another program's database, or is of another version.
    """
    data = data.absolute()
    if data.exists() and (not data.is_dir() or any(data.iterdir())):
        raise InvalidInput(f"data must be a folder that does not exist yet; received {data}")
    _check_readable(file)
    partial: Path | None = None
    try:
        data.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(dir=data.parent, prefix=f".{data.name}-"))  # for its owner only
        manifest, n_files = _read(file, partial)
        for part in (*partial.rglob("*"), partial):
            if not part.is_symlink():
                sync(part)
        if data.exists():
            data.rmdir()
        (partial / FOLDER).rename(data)
        sync(data.parent)
    except OSError as error:
        raise InvalidInput(f"data must be writable; {data} is not: {reason(error)}") from error
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)
    return {"data": str(data), "files": n_files, "created": manifest["created"]}


def _check_readable(file: Path) -> None:
    """Refuse what is no file, such as a pipe, before it is waited for."""
    try:
        if not stat.S_ISREG(file.stat().st_mode):
            raise InvalidInput(f"backup must be a file that can be read; {file} is none")
        with file.open("rb"):
            pass
    except OSError as error:
        raise InvalidInput(
            f"backup must be a file that can be read; {file} is not: {reason(error)}"
        ) from error


def _write(data: Path, stream: Any, scratch: Path) -> int:
    """Write everything into a tar file; the number of files."""
    checksums: dict[str, str] = {}
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as archive:
        created = datetime.now(UTC).isoformat(timespec="milliseconds")
        manifest = {"kind": KIND, "schema_version": SCHEMA_VERSION, "created": created}
        manifest["coilcal"] = version("coilcal")
        _add(archive, MANIFEST, json.dumps(manifest).encode(), {})
        with tempfile.TemporaryDirectory(dir=scratch) as folder:
            copy = Path(folder) / DATABASE
            _copy_database(data / DATABASE, copy)
            _add(archive, f"{FOLDER}/{DATABASE}", copy.read_bytes(), checksums)
        for file in _files(data):
            name = f"{FOLDER}/{file.relative_to(data).as_posix()}"
            try:
                if file.is_symlink():
                    _add_link(archive, name, file, data)
                else:
                    _add(archive, name, file.read_bytes(), checksums)
            except FileNotFoundError:  # a job has replaced or finished it
                continue
        _add(archive, CHECKSUMS, json.dumps(checksums).encode(), {})
    return len(checksums)


def _copy_database(database: Path, copy: Path) -> None:
    try:
        with closing(sqlite3.connect(database)) as source, closing(sqlite3.connect(copy)) as target:
            source.backup(target)
            target.execute("PRAGMA journal_mode=DELETE")  # one file, without a log beside it
    except sqlite3.Error as error:
        raise explained(database, error) from error


def _files(data: Path) -> Iterator[Path]:
    """Files of the folders, those first that mark others as complete."""
    for part in sorted(data.iterdir()):
        if part.is_symlink() or not part.is_dir() or part.name == UPLOADS:
            continue
        for folder in sorted(part.iterdir()):
            if is_unfinished(folder.name):
                continue
            if part.name == SESSIONS and is_growing(folder):
                yield folder / JOURNAL  # its arrays are being made, or are not there
            elif folder.is_file():
                yield folder
            else:
                yield from _marks_first(folder)


def _marks_first(folder: Path) -> list[Path]:
    marks = [path for name in MARKS for path in folder.rglob(name)]
    marks.sort(key=lambda path: (len(path.parts), MARKS.index(path.name)))
    known = set(marks)
    others = (path for path in folder.rglob("*") if path.is_symlink() or path.is_file())
    return marks + [path for path in others if path not in known]


def _add(archive: tarfile.TarFile, name: str, content: bytes, checksums: dict[str, str]) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = len(content), 0o600
    archive.addfile(member, io.BytesIO(content))
    checksums[name] = hashlib.sha256(content).hexdigest()


def _add_link(archive: tarfile.TarFile, name: str, link: Path, data: Path) -> None:
    """A link to something in the data folder, relative wherever the folder will be; others are left out."""
    target = Path(os.path.normpath(link.parent / link.readlink()))
    if target.is_relative_to(data):
        member = tarfile.TarInfo(name)
        member.type, member.linkname = tarfile.SYMTYPE, os.path.relpath(target, link.parent)
        archive.addfile(member)


def _read(file: Path, folder: Path) -> tuple[dict[str, Any], int]:
    """Unpack a backup and compare it with its checksums; its manifest and the number of its files."""
    try:
        with tarfile.open(file, mode="r:") as archive:
            archive.extractall(folder, filter="data")
        manifest, checksums = (
            json_object((folder / name).read_bytes(), name, CorruptStore) for name in (MANIFEST, CHECKSUMS)
        )
        kind = (manifest["kind"], manifest["schema_version"])
        is_whole = isinstance(manifest["created"], str) and f"{FOLDER}/{DATABASE}" in dict(checksums)
    except FileNotFoundError as error:
        raise CorruptStore(f"backup must be whole; {file} lacks {Path(str(error.filename)).name}") from error
    except CorruptStore as error:
        raise CorruptStore(f"backup must be readable; {file} is damaged: {error}") from error
    except UNREADABLE as error:
        raise CorruptStore(f"backup must be readable; {file} is damaged: {type(error).__name__}") from error
    if kind != (KIND, SCHEMA_VERSION) or not is_whole:
        raise CorruptStore(f"backup must be of kind {KIND!r}, version {SCHEMA_VERSION}; {file} is not")
    (folder / FOLDER).chmod(0o700)
    paths = (path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())
    packed = {path.relative_to(folder).as_posix(): path for path in paths}
    names = packed.keys() - {MANIFEST, CHECKSUMS}
    for name in sorted(names | checksums.keys()):
        if name not in names or hashlib.sha256(packed[name].read_bytes()).hexdigest() != checksums.get(name):
            raise CorruptStore(f"backup must match its checksums; {name} does not ({file})")
    try:
        check_database(folder / FOLDER / DATABASE)
    except CoilcalError as error:
        sentence = str(error).replace(str(folder / FOLDER / DATABASE), f"that in {file}")
        raise CorruptStore(sentence) from error
    return manifest, len(checksums)
