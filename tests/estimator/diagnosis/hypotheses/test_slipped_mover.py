"""A mover that lost steps is told from sensors that were bumped at the same instant, in one race; both hidden by independent code."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.hypotheses.candidates import causes_of
from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.rig.rig import Cause
from estimator.rig_files.read import load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.estimator.diagnosis.mixture.weighed import weighed
from tests.estimator.diagnosis.small_fits import fit_of
from tests.hidden.session import draw_session

SEED, SIGMA = 150_300, 12.0
SLIPPED, BUMPED = "mover_slipped", "sensor_bumped"


def fit_of_hidden(name: str, folder: Path) -> tuple[Fit, str]:
    """Fit of the rig as described to a session of two sensors with that flaw, and the place of the flaw."""
    hidden = draw_session(SEED, name, SIGMA, "recommended")
    hidden.write(folder)
    session = read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))
    return fit_of(session.rig, session.observations.calibration), hidden.record.truths[0].place


@pytest.mark.whole
@pytest.mark.parametrize("name", [SLIPPED, BUMPED])
def test_the_same_shift_at_all_sensors_is_the_movers_and_at_one_the_sensors(name, tmp_path):
    fit, place = fit_of_hidden(name, tmp_path)
    asked = [cause for cause in causes_of(fit.rig, fit) if cause.name in (SLIPPED, BUMPED)]
    assert len(asked) == 3
    evidence = {cause: value for cause, (value, _) in weighed(fit, asked).items()}
    best = max(evidence, key=evidence.__getitem__)
    assert best == Cause(name, "arm1" if name == SLIPPED else place)
    assert all(evidence[best] > value + 5.0 for cause, value in evidence.items() if cause != best)


@pytest.mark.whole
def test_it_is_not_asked_where_a_bumped_sensor_does_the_same(tmp_path):
    draw_session(SEED, None, SIGMA, "recommended").write(tmp_path)
    session = read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml"))
    both = session.observations
    one = both.rows(both.sensor == 0).alone
    slipped = EFFECTS[SLIPPED]
    assert slipped.concerns(Circumstances(session.rig, both), "arm1")
    assert not slipped.concerns(Circumstances(session.rig, one), "arm1")
