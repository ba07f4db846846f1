"""Gives the service rigs and sessions; what it has already is not sent again."""

from __future__ import annotations

import tempfile
from pathlib import Path

from estimator.client.connection import Http
from estimator.rig.rig import Rig
from estimator.rig_files.write import rig_text
from estimator.store.session import Session
from estimator.store.zipped import zipped


async def upload_rig(connection: Http, rig: Rig) -> str:
    """The id of a rig's version, the same for the same rig."""
    headers = {"Content-Type": "application/yaml"}
    known = await connection.json("POST", "/v1/rigs", content=rig_text(rig).encode(), headers=headers)
    return str(known["id"])


async def upload(connection: Http, session: Session) -> str:
    """The id of a session."""
    params = {"hash": session.hash, "limit": 1}
    known = (await connection.json("GET", "/v1/sessions", params=params))["items"]
    if known:
        return str(known[0]["id"])
    rig_id = await upload_rig(connection, session.rig)
    info = await connection.json(
        "POST",
        "/v1/sessions/import-zip",
        params={"rig_id": rig_id},
        headers={"Content-Type": "application/zip"},
        content=await connection.work(lambda: _zipped(session)),
    )
    return str(info["id"])


def _zipped(session: Session) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.zarr"
        session.save(path)
        return zipped(path)
