"""The chain of a calibration on disk: begun, continued after a kill, or refused where it belongs to another calibration."""

from __future__ import annotations

from pathlib import Path

from emcee.backends import Backend

from estimator.calibration.files import CHAIN_STORE, SUMMARY_FILE, check_calibration, remove_calibration
from estimator.errors import CorruptStore, InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.json_files import read_json
from estimator.rig.coordinates import Coordinates
from estimator.store.emcee_backend import ZarrBackend
from estimator.store.made import check_folder


def unfinished_chain(folder: Path | None, fingerprint: str, overwrite: bool) -> Backend | None:
    """The chain to continue; None if the folder holds none that is to be continued."""
    if folder is None:
        return None
    check_folder(folder.absolute())
    check_calibration(folder)
    if overwrite:
        return None
    if _is_finished(folder):
        raise InvalidInput(
            f"output must not hold a finished calibration unless --overwrite replaces it; received {folder}"
        )
    path = folder / CHAIN_STORE
    if not path.exists():
        return None
    try:
        return ZarrBackend.open(path, fingerprint=fingerprint)
    except InvalidInput as error:
        raise InvalidInput(
            "output must be empty, hold an unfinished calibration of the same session, rig, seed, walkers and versions, "
            f"or be replaced with --overwrite; received {folder}, which holds another calibration"
        ) from error


def new_chain(
    folder: Path | None,
    coordinates: Coordinates,
    settings: SamplerSettings,
    fingerprint: str,
    overwrite: bool,
) -> Backend:
    """A chain that begins: in the folder, or in memory where there is none."""
    if folder is None:
        return Backend()
    if overwrite:
        remove_calibration(folder)
    return ZarrBackend.create(
        folder / CHAIN_STORE,
        coordinate_names=coordinates.labels,
        n_walkers=settings.n_walkers,
        checkpoint_steps=settings.check_every,
        fingerprint=fingerprint,
    )


def _is_finished(folder: Path) -> bool:
    """Whether a folder holds a calibration that reached its targets."""
    if not (folder / SUMMARY_FILE).exists():
        return False
    try:
        return bool(read_json(folder / SUMMARY_FILE, fault=CorruptStore).get("is_converged", True))
    except CorruptStore:
        return True  # damaged, but not to be overwritten unasked
