"""Two pieces of iron in one session, by the generator's own polarisable spheres: both are named, where they are."""

from __future__ import annotations

import pytest

from estimator import diagnose, load_rig
from estimator.diagnosis.verdict import Verdict
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.study import draw_case

SEED = 61_001
PLACE_TOLERANCE_M = 6e-3


@pytest.mark.slow
def test_both_pieces_are_named_where_they_are(tmp_path):
    hidden = draw_case("outside", SEED)
    hidden.write(tmp_path)
    session = read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml"))
    diagnosis = diagnose(session, seed=SEED)
    assert diagnosis.verdict is Verdict.NAMED
    assert [named.cause.name for named in diagnosis.findings.causes] == ["iron_body", "second_iron_body"]
    (truth,) = hidden.truth()["causes"]
    for which, name in (("first", "iron_body"), ("second", "second_iron_body")):
        for axis in "xyz":
            fitted_m = float(diagnosis.fits.extended.values[f"{name}[room].{axis}_m"])
            true_m = truth["parameters"][f"{which}_{axis}_m"]["value"]
            assert fitted_m == pytest.approx(true_m, abs=PLACE_TOLERANCE_M)
