"""Files of a calibration: a posterior with its readings in zarr, and a summary that marks it as complete."""

from __future__ import annotations

import hashlib
import json
import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from estimator.errors import CorruptStore, InvalidInput, quoted
from estimator.given_files import MOST_RESULT_BYTES, read_given
from estimator.json_files import json_object
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.state import rig_from_state, rig_state
from estimator.store.admission import admit, admit_readings
from estimator.store.arrays import ARRAYS, observation_arrays, observations_from
from estimator.store.files import kind_of, write_text, writing
from estimator.store.made import GROUP, Made, arrays_of, holds
from estimator.store.staging import staged
from estimator.store.tree import Node, read_tree, tree_hash, write_tree

SCHEMA_VERSION = 1
INSIDE = "calibration"  # folder in that of a diagnosis, `estimator.diagnosis.result`
POSTERIOR_STORE, SUMMARY_FILE, CHAIN_STORE, REPORT = (
    "posterior.zarr",
    "summary.json",
    "chain.zarr",
    "report.html",
)
SUMMARY_SEAL = "summary_sha256"
SUMMARY_KEYS: Mapping[str, type] = {
    **dict.fromkeys(
        ("parameters", "prior_tension", "rmse", "rmse_nominal", "rmse_by_sensor", "coverage90"), dict
    ),
    **dict.fromkeys(("sampling", "point_estimate", "truth", "versions"), dict),
    **dict.fromkeys(("loop_counts", "undetermined"), list),
    **dict.fromkeys(("is_converged", "has_integer_counts"), bool),
    **dict.fromkeys(("session_source", "session_created", "session_hash", "rig_hash"), str),
    "seed": int,
}
"""What pages read of a summary; one that is older than its seal may have been altered unnoticed."""


class Parts(NamedTuple):
    """What files hold, as `Calibration` has it."""

    rig: Rig
    observations: Observations
    best: Mapping[str, float]
    draws: Mapping[str, np.ndarray]
    log_prob: np.ndarray
    summary: Mapping[str, Any]


def write_parts(parts: Parts, folder: Path) -> None:
    """Write posterior and summary; `Calibration.save` says how.

    Raises:
        InvalidInput: The folder cannot be written, or files of somebody else have these names in it.
    """
    CALIBRATION.check_open(folder)
    summary = json.dumps(parts.summary, indent=2, allow_nan=False) + "\n"
    with writing(folder):
        with staged(folder / POSTERIOR_STORE, overwrite=True, made=POSTERIOR) as new:
            _write_posterior(parts, new, summary)
            (folder / SUMMARY_FILE).unlink(missing_ok=True)  # never beside a posterior that is not its own
        write_text(folder / SUMMARY_FILE, summary)


def read_parts(folder: Path) -> Parts:
    """Read what `write_parts` wrote.

    Raises:
        InvalidInput: The folder holds no finished calibration.
        CorruptStore: A file in it is damaged.
    """
    if not (folder / SUMMARY_FILE).is_file():
        inner = folder / INSIDE
        hint = f"; the calibration of this diagnosis is {inner}" if (inner / SUMMARY_FILE).is_file() else ""
        raise InvalidInput(
            f"calibration must be a folder that coilcal calibrate finished (with {SUMMARY_FILE}); received {folder}{hint}"
        )
    admit(folder / POSTERIOR_STORE, "calibration")
    try:
        text = read_given(folder / SUMMARY_FILE, MOST_RESULT_BYTES, CorruptStore)
        summary = json_object(text, folder / SUMMARY_FILE, CorruptStore)
        tree = read_tree(folder / POSTERIOR_STORE)
        attributes = tree["/"].attributes
        _check_seals(tree, text, folder)
        arrays = {**tree["/constant_data"].arrays, **tree["/observed_data"].arrays}
        rig = rig_from_state(json_object(attributes["rig"], folder), f"rig inside {folder}")
        admit_readings(arrays, rig, str(folder))
        observations, best = observations_from(arrays, rig), json_object(attributes["best"], folder)
        draws, log_prob = tree["/posterior"].arrays, tree["/sample_stats"].arrays["lp"]
        _check_numbers(rig, best, draws, log_prob, folder)
        if any(not isinstance(summary[key], kind) for key, kind in SUMMARY_KEYS.items()):
            raise CorruptStore(
                f"calibration must have a summary as coilcal writes it; {folder / SUMMARY_FILE} is another"
            )
    except CorruptStore:
        raise
    except Exception as error:  # zarr, JSON and NumPy raise errors of many types on damaged bytes
        raise CorruptStore(
            f"calibration must be readable; {folder} is damaged: {type(error).__name__} {error}"
        ) from error
    return Parts(rig, observations, best, draws, log_prob, summary)


def _check_seals(tree: Mapping[str, Node], summary: bytes, folder: Path) -> None:
    """Refuse a posterior of another schema, and a posterior or summary that was altered."""
    attributes = tree["/"].attributes
    if (version := attributes["schema_version"]) != SCHEMA_VERSION:
        raise CorruptStore(
            f"calibration schema_version must be {SCHEMA_VERSION}; received {quoted(version)} ({folder})"
        )
    stored_hash = attributes.pop("sha256")
    if stored_hash != tree_hash(tree):
        raise CorruptStore(
            f"calibration must match its SHA-256; {folder / POSTERIOR_STORE} was altered or lost a chunk"
        )
    # Version 0.1 and the first of 0.2 did not seal the summary.
    if attributes.get(SUMMARY_SEAL, _sha256(summary)) != _sha256(summary):
        raise CorruptStore(
            f"calibration must match its SHA-256; {folder / SUMMARY_FILE} was altered, or belongs to another posterior"
        )


def _write_posterior(parts: Parts, path: Path, summary: str) -> None:
    walkers, steps = parts.log_prob.shape
    attributes = {
        "schema_version": SCHEMA_VERSION,
        "rig": json.dumps(rig_state(parts.rig)),
        "best": json.dumps(dict(parts.best)),
        SUMMARY_SEAL: _sha256(summary.encode()),
    }
    axes = ("chain", "draw")
    coordinates = {"chain": (axes[:1], np.arange(walkers)), "draw": (axes[1:], np.arange(steps))}
    posterior = {name: (axes, draws) for name, draws in parts.draws.items()}
    arrays = observation_arrays(parts.observations)
    tree = {
        "/": Node(attributes, {}),
        "/posterior": Node({"inference_library": "emcee"}, {**posterior, **coordinates}),
        "/sample_stats": Node({}, {"lp": (axes, parts.log_prob), **coordinates}),
        "/observed_data": Node({}, {"field_sensor_T": arrays.pop("field_sensor_T")}),
        "/constant_data": Node({}, arrays),
    }
    attributes["sha256"] = tree_hash(tree)
    write_tree(path, tree)


# By what damage may leave of them, too.
POSTERIOR_FILES = (
    rf"zarr\.json|(?:posterior|sample_stats)/(?:{arrays_of('[^/]+')})"
    rf"|(?:observed_data|constant_data)/(?:{arrays_of(ARRAYS)})"
)
CHAIN_FILES = arrays_of("chain|log_prob|checkpoint|accepted")
POSTERIOR = Made(
    "a posterior",
    POSTERIOR_FILES,
    (GROUP,),
    lambda folder: holds(folder / GROUP, '"best"') or (folder / "sample_stats" / GROUP).is_file(),
)
CHAIN = Made(
    "a chain of samples",
    CHAIN_FILES,
    (GROUP,),
    lambda folder: holds(folder / GROUP, '"array_crc32"') or (folder / "log_prob" / GROUP).is_file(),
)
CALIBRATION = Made(
    "a calibration",
    rf"summary\.json|report\.html|posterior\.zarr/(?:{POSTERIOR_FILES})|chain\.zarr/(?:{CHAIN_FILES})",
    (SUMMARY_FILE, POSTERIOR_STORE, CHAIN_STORE, REPORT),
    lambda folder: (
        holds(folder / SUMMARY_FILE, '"coverage90"')
        or POSTERIOR.is_one(folder / POSTERIOR_STORE)
        or CHAIN.is_one(folder / CHAIN_STORE)
    ),
)


def remove_calibration(folder: Path) -> None:
    """Delete the files of an earlier calibration from a folder, and nothing else.

    Raises:
        InvalidInput: One of them holds something that coilcal did not write; nothing is deleted then.
    """
    check_calibration(folder)
    for name in CALIBRATION.names:
        path = folder / name
        if kind_of(path) == "a folder":
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def check_calibration(folder: Path) -> None:
    """Refuse a folder in which files of somebody else have the names of a calibration.

    Raises:
        InvalidInput: It holds such files.
    """
    CALIBRATION.check_open(folder)
    for name, store in ((POSTERIOR_STORE, POSTERIOR), (CHAIN_STORE, CHAIN)):
        if kind_of(folder / name) is not None:
            store.check_replaceable(folder / name)
    for name in (SUMMARY_FILE, REPORT):
        if kind_of(folder / name) not in (None, "a file"):
            raise InvalidInput(f"output must be a file; {folder / name} is {kind_of(folder / name)}")


def _check_numbers(
    rig: Rig, best: Mapping[str, float], draws: Mapping[str, np.ndarray], log_prob: np.ndarray, folder: Path
) -> None:
    """Refuse a posterior that lacks a number of the rig, or holds another shape or no finite number."""
    for name in rig.parameters:
        if not math.isfinite(best[name]):
            raise CorruptStore(f"best {name} must be finite; received {best[name]} ({folder})")
    for parameter in rig.free:
        values = draws[parameter.name]
        if values.shape != log_prob.shape or not np.isfinite(values).all():
            raise CorruptStore(
                f"draws of {parameter.name} must be finite and of shape {log_prob.shape}; "
                f"received {'others' if values.shape == log_prob.shape else values.shape} ({folder})"
            )


def _sha256(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()
