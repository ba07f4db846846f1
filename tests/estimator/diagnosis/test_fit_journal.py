"""An interrupted diagnosis goes on where it was, and ends bit by bit as one that was not interrupted."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
import torch

from estimator.diagnosis import fitting
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.fit_journal import FITS, FitJournal, key_of, remembering
from estimator.diagnosis.fit_place import FitSetting, fitting_by
from estimator.diagnosis.limits import Limits
from estimator.inference import secant
from estimator.json_files import read_json
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.rig import Cause
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong

pytestmark = pytest.mark.whole

OFFSET = Cause("sensor_offset", "hall")


@pytest.fixture(scope="module")
def session(small_rig, small_session, small_truth) -> Session:
    rig = small_rig.with_values(small_truth)
    readings = with_wrong(rig, small_session.observations, OFFSET, {"x_T": 30e-6, "z_T": -20e-6})
    return Session(small_rig, readings, "with an offset")


class Killed(BaseException):
    """Stands for a signal that cannot be caught."""


@pytest.mark.parametrize(
    "many_directions", [secant.MANY_DIRECTIONS, pytest.param(1, marks=pytest.mark.slow)]
)  # without and with secants
def test_a_killed_diagnosis_goes_on_and_ends_as_if_it_had_not_been(
    session, tmp_path, monkeypatch, many_directions
):
    monkeypatch.setattr(secant, "MANY_DIRECTIONS", many_directions)
    limits = Limits(most_causes=2)
    whole = diagnose(session, seed=1, out=tmp_path / "whole", has_corrections=False, limits=limits)
    n_fits = []
    climb = fitting.climbed

    def killed_after_three(*args, **kwargs):
        n_fits.append(1)
        if len(n_fits) > 3:
            raise Killed
        return climb(*args, **kwargs)

    monkeypatch.setattr(fitting, "climbed", killed_after_three)
    with pytest.raises(Killed):
        diagnose(session, seed=1, out=tmp_path / "killed", has_corrections=False, limits=limits)
    with (tmp_path / "killed" / FITS).open("a") as file:
        file.write('{"key": "torn')
    monkeypatch.setattr(fitting, "climbed", climb)
    told = []
    diagnose(
        session, seed=1, out=tmp_path / "killed", has_corrections=False, limits=limits, on_stage=told.append
    )
    assert told[0] == "continuing: 3 fits were made before"
    written, expected = (read_json(tmp_path / name / "diagnosis.json") for name in ("killed", "whole"))
    assert written == expected == json.loads(json.dumps(whole.to_json()))
    assert not (tmp_path / "killed" / FITS).exists()


@pytest.mark.parametrize(
    ("at", "words"),
    [
        pytest.param("asking what is wrong", "it was stopped", marks=pytest.mark.slow),
        ("sampling", "it was stopped after its causes were found"),
    ],
)
def test_one_that_is_stopped_samples_nothing_and_says_so(session, tmp_path, at, words):
    """Also where its causes were found."""
    limits = Limits(most_causes=2)

    def stop(stage: str) -> None:
        if at in stage:
            limits.stopped.set()

    stopped = diagnose(
        session, seed=1, out=tmp_path / "out", has_posterior=True, limits=limits, on_stage=stop
    )
    assert limits.stopped.is_set()
    assert stopped.posterior is None
    correction = stopped.fits.correction
    assert correction is None or (correction.is_cut_short and not correction.is_taken)
    assert stopped.findings.answer.ended_early == words
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "diagnosis.json",
        FITS,
        "rig_extended.yaml",
    ]


def test_another_rig_other_readings_and_another_start_are_other_fits(small_rig, session, tmp_path):
    readings = session.observations.calibration
    with remembering(tmp_path) as journal, fitting_by(FitSetting(journal)):
        first = fit_of(small_rig, readings)
        n = len(FitJournal(tmp_path / FITS))
        again = fit_of(small_rig, readings)
        assert len(FitJournal(tmp_path / FITS)) == n
        fit_of(small_rig, readings.with_field(readings.field_sensor_T + 1e-6))
        fit_of(small_rig.with_values({"hall.noise_T": 6e-6}), readings)
        assert len(FitJournal(tmp_path / FITS)) == n + 2
    assert torch.equal(first.optimum.vector, again.optimum.vector)
    assert torch.equal(first.optimum.precision, again.optimum.precision)
    assert first.log_evidence == again.log_evidence


def test_an_empty_folder_is_not_left_behind(tmp_path):
    with pytest.raises(ValueError), remembering(tmp_path / "new"):  # noqa: PT011 - any error
        raise ValueError
    assert not (tmp_path / "new").exists()


def test_a_fit_on_another_device_or_by_other_rules_is_another(small_rig, small_session):
    readings = small_session.observations
    rules = MeasurementModel.build(small_rig, readings).rules
    finer = {name: replace(rule, axial_nodes=rule.axial_nodes + 1) for name, rule in rules.items()}
    start = torch.zeros(1, 3, dtype=torch.float64)
    keys = {
        key_of(small_rig, readings, start, 0.1, some_rules, place)
        for some_rules in (rules, finer)
        for place in (None, (torch.device("cuda"), torch.float32))
    }
    assert len(keys) == 4
