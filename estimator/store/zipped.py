"""Folders as zip files."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path


def zipped(folder: Path, parts: Sequence[str] = ()) -> bytes:
    """A folder as a zip file, always the same bytes for the same content; zarr has compressed it already.

    Args:
        folder: What to zip.
        parts: Names of those of its files and folders that are wanted; all by default.
    """
    wanted = [folder / part for part in parts] or [folder]
    paths = [path for part in wanted for path in (part, *part.rglob("*"))]
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        for path in sorted(path for path in paths if path.is_file()):
            archive.writestr(zipfile.ZipInfo(path.relative_to(folder).as_posix()), path.read_bytes())
    return buffer.getvalue()
