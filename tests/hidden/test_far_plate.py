"""A plate of steel that turns and wire of the coil absorb: nothing is found, and the answer says that the readings could not have shown it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from estimator import diagnose, load_rig
from estimator.diagnosis.headline import headline
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.far_plate import write_far_plate

pytestmark = pytest.mark.whole


def test_a_plate_that_the_coil_absorbs_is_told_among_what_could_not_have_shown(tmp_path):
    write_far_plate(tmp_path, 0.16, np.random.default_rng(1))
    session = read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml"))
    diagnosis = diagnose(session, seed=1)
    assert diagnosis.verdict == "nothing_found"
    loops = diagnosis.fits.plain.values["coil1.axial_loops"]
    assert abs(float(loops) - 30.0) > 0.5  # what the plate did to them
    last = headline(diagnosis)[-1]
    assert "(iron_plate[room]), up to strength " in last
    assert "% at z = −" in last
    wrong = re.search(r": turns would absorb it, and be wrong by up to ([\d.]+) %", last)
    assert wrong is not None
    assert float(wrong[1]) > 100.0 * abs(float(loops) / 30.0 - 1.0)  # as far as they are
    assert last.endswith("Where nothing of that kind can be, use the rig file as it is.")
    hidden = diagnosis.to_json()["smallest_visible"]["iron_plate.strength"]
    assert hidden["hidden_in"] == "coil1.turns"
    assert hidden["hidden_at"]["axis"] == 2.0  # across the coil's axis
    assert hidden["hidden_size"] > 10.0 * hidden["size"]  # the smallest visible size is that of another place
