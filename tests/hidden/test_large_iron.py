"""A ball of iron larger than a tool is put where it is: the prior of its size has a tail. Place and size are those the rule was made with."""

from __future__ import annotations

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.far_plate import FRONT_M
from tests.hidden.large_iron import write_large_iron

pytestmark = pytest.mark.whole

BALL_M, RADIUS_M = np.array([0.13, -0.05, 0.02]), 0.06


def test_it_is_no_smaller_piece_nearer_by(tmp_path):
    write_large_iron(tmp_path, BALL_M, RADIUS_M, 3.0, np.random.default_rng(11))
    session = read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml"))
    diagnosis = diagnose(session, seed=1)
    found = diagnosis.sized_causes[0]
    assert found.cause.name == "iron_body"
    truths_m = dict(zip(("x_m", "y_m", "z_m"), BALL_M + FRONT_M, strict=True))
    for key, truth in {"volume_m3": RADIUS_M**3, **truths_m}.items():
        told = found.quantities[key]
        assert abs(told.median - truth) < 3.0 * told.sd, key
