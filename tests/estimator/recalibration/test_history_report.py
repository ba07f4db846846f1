"""What the page of a registry warns of: a drift while it holds, and a calibration that did not converge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from estimator.calibration.result import Calibration
from estimator.recalibration.history_report import _sentence, _warnings
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry

DRIFT = Entry(
    "drifted",
    "a magnet",
    "b.zarr",
    "b",
    "2026-02-01T00:00:00+00:00",
    agrees=False,
    since="2026-02-01T00:00:00+00:00",
)
AGREES = Entry("unchanged", "agrees", "c.zarr", "c", "2026-03-01T00:00:00+00:00", agrees=True)
OLD = replace(AGREES, taken="2026-01-15T00:00:00+00:00")
UPDATED = Entry("updated", "mounted anew", "d.zarr", "d", "2026-04-01T00:00:00+00:00", agrees=False)


@pytest.fixture
def registry(small_calibration: Calibration, tmp_path: Path) -> Registry:
    registry = Registry(tmp_path)
    with registry.writing():
        registry.commit(
            Entry("updated", "first", "a.zarr", "a", "2026-01-01T00:00:00+00:00"), small_calibration
        )
    return registry


@pytest.mark.parametrize(
    ("is_extended", "later", "is_warned"),
    [
        (False, [], True),
        (True, [], True),
        (True, [AGREES], True),  # with the version that knows of the drift
        (False, [AGREES], False),  # with the version that does not
        (False, [OLD], True),
        (True, [UPDATED], False),
    ],
)
def test_a_drift_is_warned_of_while_it_holds(registry, small_calibration, is_extended, later, is_warned):
    with registry.writing():
        registry.commit(DRIFT, small_calibration if is_extended else None)
        for entry in later:
            registry.commit(entry, small_calibration if entry.conclusion == "updated" else None)
    warned = _warnings(registry, registry.entries())
    assert [words.startswith("Drift since 2026-02-01") for words in warned] == [True] * is_warned


def test_a_drift_is_not_warned_of_after_its_version_was_rolled_back(registry, small_calibration):
    with registry.writing():
        registry.commit(DRIFT, small_calibration)
        registry.roll_back(1)
    assert _warnings(registry, registry.entries()) == []


def test_the_name_of_a_cause_is_written_as_the_rig_file_has_it():
    assert _sentence(replace(DRIFT, reason="iron_body (2 cm³)")) == "iron_body (2 cm³)."
    assert _sentence(AGREES) == "Agrees."


def test_calibrations_that_did_not_converge_are_warned_of(registry, small_calibration):
    with registry.writing():
        registry.commit(replace(AGREES, agrees=False, checks={"is_successor_converged": False}))
    assert _warnings(registry, registry.entries()) == [
        "The last session's calibration did not converge and replaced nothing."
    ]
    unsure = replace(small_calibration, summary_json={**small_calibration.summary(), "is_converged": False})
    with registry.writing():
        registry.commit(UPDATED, unsure)
    assert _warnings(registry, registry.entries()) == [
        "Version 2 did not converge; its intervals are provisional."
    ]
