"""A cause that no list holds: the verdict stays honest, and what is handed out is judged as it predicts.

A screw whose pitch errs moves the coil, which predictions can follow.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.cli.diagnose import _text
from estimator.diagnosis.headline import headline
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.report import diagnosis_report
from estimator.diagnosis.result import Diagnosis
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.handed_in import HiddenSession
from tests.hidden.open_session import draw_open_session
from tests.hidden.study import OPEN_KINDS

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def screw() -> HiddenSession:
    """At 30 sigma, of `unknown30` as it was before it knew the causes of the exam; rules were not tuned on it."""

    def chosen(possible: Sequence[str]) -> list[str]:
        return [name for name in possible if name == "screw_pitch_error"]

    return draw_open_session([993, OPEN_KINDS.index("unknown30")], chosen, 30.0, 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("corrected")


@pytest.fixture(scope="module")
def diagnosis(screw: HiddenSession, folder: Path) -> Diagnosis:
    screw.write(folder)
    session = read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))
    return diagnose(session, seed=screw.seed, out=folder / "out", limits=Limits(most_causes=1))


def test_unknown_cause_is_not_named_and_unseen_readings_are_predicted_better(screw, diagnosis):
    assert diagnosis.verdict == "unexplained"
    assert diagnosis.causes == ()
    assert diagnosis.improvement is not None
    before_T, after_T = (
        s.errors.vector_T for s in (diagnosis.improvement.before, diagnosis.improvement.after)
    )
    noise_T = np.sqrt(3.0 * float(np.square(screw.scene.noise_T).mean()))
    excess_after_T, excess_before_T = (
        np.sqrt(max(error_T**2 - noise_T**2, 0.0)) for error_T in (after_T, before_T)
    )
    assert (
        excess_after_T < 0.5 * excess_before_T
    )  # of what the noise does not explain, less than half is left
    assert diagnosis.improvement.is_significant


def test_files_and_report_keep_explained_corrected_and_left_apart(folder, diagnosis):
    correction = diagnosis.fits.correction
    assert correction is not None
    told = json.loads((folder / "out/diagnosis.json").read_text())["correction"]
    assert [part["name"] for part in told["parts"]] == [part.cause.name for part in correction.parts]
    assert told["parts"][0]["extent"].startswith("with a period of ")
    assert told["refusal"] == ""
    assert told["gain"]["with_correction"]["vector_T"] < told["gain"]["with_causes"]["vector_T"]
    rig = load_rig(folder / "out/rig_extended.yaml")
    assert rig == diagnosis.extended_rig
    assert rig.corrections == tuple(part.cause for part in correction.parts)
    told = [words for words in headline(diagnosis) if not words.startswith("The diagnosis ended early")]
    assert "corrected, not explained" in told[-1]
    assert "corrected, not explained" in _text(diagnosis)
    page = diagnosis_report(diagnosis, "coilcal diagnose")
    for words in ("before", "the rest is left", "What is corrected without a name"):
        assert words in page
