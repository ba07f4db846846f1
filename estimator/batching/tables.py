"""Tables of readings among the sessions of a batch: each becomes a session in a folder of the batch, by a recipe."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from estimator.errors import CoilcalError, InvalidInput
from estimator.rig.rig import Rig
from estimator.store.importers.checked import checked
from estimator.store.importers.forms.recipe import Recipe
from estimator.store.importers.forms.understand import understood
from estimator.store.importers.readings_csv import is_readings_csv
from estimator.store.session import Session


class Imported(NamedTuple):
    """Sessions of a batch.

    Attributes:
        paths: Folders of sessions, in the order in which they were given.
        failed: Reason for each table that is no session.
    """

    paths: list[str]
    failed: dict[str, str]


def sessions_of(
    paths: Sequence[str], folder: Path, rig: Rig | None, recipe: Recipe | None, seed: int
) -> Imported:
    """Import the tables among the paths; folders stay as they are.

    Args:
        paths: Sessions, and files with tables of readings.
        folder: Where sessions of tables are written; the same table makes the same session again.
        rig: The rig of the tables.
        recipe: How their columns are read; None for readings CSV alone.
        seed: Decides which readings are kept for validation.
    """
    sessions, failed = list[str](), dict[str, str]()
    taken: dict[str, str] = {}
    for path in paths:
        if not Path(path).is_file():
            sessions.append(path)
            continue
        try:
            name = f"{Path(path).stem}.zarr"
            if taken.setdefault(name, path) != path:
                raise InvalidInput(f"names of tables must differ; {path} is named as {taken[name]} is")
            _import(Path(path), folder / name, rig, recipe, seed)
            sessions.append(str(folder / name))
        except CoilcalError as error:
            failed[path] = str(error)
    return Imported(sessions, failed)


def _import(path: Path, out: Path, rig: Rig | None, recipe: Recipe | None, seed: int) -> None:
    if rig is None:
        raise InvalidInput(f"a table of readings needs the rig it was taken on: name it with --rig ({path})")
    is_known = recipe is not None or is_readings_csv(path, rig)
    read = understood(path, rig, recipe) if is_known else None
    if read is None or (read.proposal is not None and recipe is None):
        raise InvalidInput(
            f"{path} is no readings CSV, so --map must say how its columns are read; coilcal import writes such a file, columns.yaml"
        )
    out.parent.mkdir(exist_ok=True)
    observations = checked(rig, read.readings.observations, str(path), seed=seed).observations
    Session(rig, *read.readings._replace(observations=observations)).save(out, overwrite=True)
