"""Sessions as zip files: written for a download, and unpacked from an upload under limits, before the store's own checks."""

from __future__ import annotations

import io
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator, Set
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from estimator.errors import CoilcalError, CorruptStore
from estimator.json_files import read_json
from estimator.service.problems import Problem
from estimator.service.storage import shortage
from estimator.store.admission import METADATA, admit
from estimator.store.session import Session, load_session

MOST_MEMBERS = 5_000  # a session of 200,000 readings has about a hundred; each file takes half a millisecond
MOST_NAME = 200  # characters
MOST_LEVELS = 6  # folders inside each other; a session has four
PIECE = 1 << 20
BYTES_OF_NUMBER = 8
ENTRY = b"PK\x01\x02"  # with which each entry of the list of members begins
TIMES = "time_s"  # array with a number for each reading
METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@contextmanager
def unpacked_session(body: bytes, folder: Path, most_bytes: int, most_readings: int) -> Iterator[Session]:
    """The session in a zip file, unpacked for as long as the block lasts.

    Args:
        body: The zip file.
        folder: Where to unpack; it must not exist, and is gone afterwards.
        most_bytes: Size that it may have when unpacked.
        most_readings: Readings that it may claim; zarr makes numbers up for chunks that are missing.
    Raises:
        Problem: It is no zip file, is beyond a limit, or has a name that leads out of the folder.
        CorruptStore: The store's checks refuse it.
    """
    try:
        folder.mkdir(parents=True)
        _unpack(body, folder, most_bytes)
        if not (folder / "zarr.json").is_file():
            raise Problem(422, "archive", "must hold the zarr.json of a session at its top; it holds none")
        try:
            admit(folder, "session", most_bytes // BYTES_OF_NUMBER)
            check_length(_n_claimed(folder), most_readings)
            session = load_session(folder)
        except Problem:
            raise
        except CoilcalError as error:  # damage of an upload is a fault of the upload, not of the service
            sentence = str(error).replace(f"{folder}/", "").replace(str(folder), "the archive")
            raise UploadRefused(sentence) from error
        yield session
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def check_length(n_readings: int, most_readings: int) -> None:
    """Refuse a session that has more readings than the service takes."""
    if n_readings > most_readings:
        raise Problem(413, "session", f"must have at most {most_readings} readings", n_readings)


def _n_claimed(folder: Path) -> int:
    """Readings of a session that was admitted, by its metadata; 0 where they do not say."""
    file = folder / TIMES / METADATA
    shape = read_json(file, fault=CorruptStore).get("shape") if file.is_file() else None
    return int(shape[0]) if shape else 0


class UploadRefused(CoilcalError):
    """What was uploaded is damaged, or no session."""


def _unpack(body: bytes, folder: Path, most_bytes: int) -> None:
    """Unpack by the bytes that come out, not by the sizes that the archive claims."""
    if (n := body.count(ENTRY)) > MOST_MEMBERS:  # before a list of them is made
        raise Problem(413, "archive", f"must hold at most {MOST_MEMBERS} files", n)
    try:
        with zipfile.ZipFile(io.BytesIO(body)) as archive:
            members = archive.infolist()
            _check_names({member.filename for member in members}, len(members))
            left = most_bytes
            for member in members:
                _check_member(member)
                if not member.is_dir():
                    left -= _unpack_file(archive, member, folder, left, most_bytes)
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        RuntimeError,  # encrypted, or compressed in a way that zipfile does not know
        ValueError,
        OSError,
    ) as error:
        if shortage(error) is not None:  # no fault of the archive
            raise
        raise Problem(
            422, "archive", f"must be a zip file that can be read: {type(error).__name__}"
        ) from error


def _unpack_file(
    archive: zipfile.ZipFile, member: zipfile.ZipInfo, folder: Path, left: int, most_bytes: int
) -> int:
    """Unpack one file; its size in bytes."""
    path = folder.joinpath(*PurePosixPath(member.filename).parts)
    path.parent.mkdir(parents=True, exist_ok=True)
    size = 0
    with archive.open(member) as source, path.open("xb") as target:
        while piece := source.read(PIECE):
            size += len(piece)
            if size > left:
                raise Problem(
                    413, "archive", f"must have at most {most_bytes} bytes when unpacked; it has more"
                )
            target.write(piece)
    return size


def _check_names(names: Set[str], n_members: int) -> None:
    if len(names) < n_members:
        raise Problem(422, "archive", "must hold each name once", place=f"{n_members - len(names)} too many")


def _check_member(member: zipfile.ZipInfo) -> None:
    name = member.filename
    path = PurePosixPath(name)
    is_odd = "\\" in name or ":" in name or not name.isprintable() or not name.isascii()
    if is_odd or path.is_absolute() or ".." in path.parts or not path.parts:
        raise Problem(422, "archive", "must hold plain relative names", name)
    if len(name) > MOST_NAME or len(path.parts) > MOST_LEVELS:
        raise Problem(
            422,
            "archive",
            f"must hold names of at most {MOST_NAME} characters and {MOST_LEVELS} levels",
            name,
        )
    kind = stat.S_IFMT(member.external_attr >> 16)
    if kind not in (0, stat.S_IFREG, stat.S_IFDIR):
        raise Problem(422, "archive", "must hold files and folders only", name)
    if member.flag_bits & 0x1 or member.compress_type not in METHODS:
        raise Problem(422, "archive", "must be stored or deflated, without a password", name)
