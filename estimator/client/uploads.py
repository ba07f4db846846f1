"""Gives the service rigs and sessions; what it has already is not sent again."""

from __future__ import annotations

import io
import tempfile
import zipfile
from pathlib import Path

from estimator.client.steps import Steps, Work, send_json
from estimator.rig.rig import Rig
from estimator.rig_files.write import rig_text
from estimator.store.session import Session


def upload_rig(rig: Rig) -> Steps[str]:
    """The id of a rig's version, the same for the same rig."""
    headers = {"Content-Type": "application/yaml"}
    known = yield from send_json("POST", "/v1/rigs", content=rig_text(rig).encode(), headers=headers)
    return str(known["id"])


def upload(session: Session) -> Steps[str]:
    """The id of a session."""
    params = {"hash": session.hash, "limit": 1}
    known = (yield from send_json("GET", "/v1/sessions", params=params))["items"]
    if known:
        return str(known[0]["id"])
    rig_id = yield from upload_rig(session.rig)
    content: bytes = yield Work(lambda: _zipped(session))
    info = yield from send_json(
        "POST",
        "/v1/sessions/import-zip",
        params={"rig_id": rig_id},
        headers={"Content-Type": "application/zip"},
        content=content,
    )
    return str(info["id"])


def begin(rig: Rig, source: str, key: str) -> Steps[str]:
    """The id of a session that takes readings; the same key again gives the same one."""
    body = {"rig_id": (yield from upload_rig(rig)), "source": source}
    info = yield from send_json("POST", "/v1/sessions", json=body, headers={"Idempotency-Key": key})
    return str(info["id"])


def _zipped(session: Session) -> bytes:
    buffer = io.BytesIO()
    with tempfile.TemporaryDirectory() as folder, zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:
        path = Path(folder) / "session.zarr"
        session.save(path)
        for file in sorted(file for file in path.rglob("*") if file.is_file()):
            archive.write(file, file.relative_to(path).as_posix())
    return buffer.getvalue()
