"""Two pieces of iron in one session, by the generator's own polarisable spheres: both are named, where they are.

Decision 8 was made on this session: the test keeps a fault from coming back, and says nothing of how often two pieces are found.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator import diagnose, load_rig
from estimator.diagnosis.verdict import Verdict
from estimator.effects import EFFECTS
from estimator.store.importers.readings_csv import read_readings_csv
from tests.hidden.study import draw_case

SEED = 61_001
PLACE_TOLERANCE_M = 6e-3


@pytest.mark.whole
@pytest.mark.slow  # the next one has both names
def test_both_pieces_are_named_where_they_are(tmp_path):
    hidden = draw_case("outside", SEED)
    hidden.write(tmp_path)
    session = read_readings_csv(tmp_path / "readings.csv", load_rig(tmp_path / "rig.yaml"))
    diagnosis = diagnose(session, seed=SEED)
    # At this size something that no list holds may be beside either name, but no other cause of the list.
    assert diagnosis.verdict in (Verdict.NAMED, Verdict.INDISTINGUISHABLE)
    named = {named.cause.name: named.alternatives for named in diagnosis.findings.causes}
    assert named == {"iron_body": (), "second_iron_body": ()}
    (truth,) = hidden.truth()["causes"]
    values = diagnosis.fits.extended.values
    fitted_m = sorted([float(values[f"{name}[room].{axis}_m"]) for axis in "xyz"] for name in named)
    true_m = sorted(
        [truth["parameters"][f"{which}_{axis}_m"]["value"] for axis in "xyz"] for which in ("first", "second")
    )
    assert fitted_m == [pytest.approx(place_m, abs=PLACE_TOLERANCE_M) for place_m in true_m]


@pytest.mark.whole
def test_two_pieces_are_neither_a_reversed_layer_nor_scatter_of_the_mover(tmp_path):
    """A linear model liked a reversed layer better than both fitted pieces, and what that left was named scatter."""
    named = names_of("iron", 489_003, tmp_path)
    assert {"iron_body", "second_iron_body"} <= named
    assert "position_jitter" not in named


@pytest.mark.whole
def test_a_piece_beside_one_of_no_volume_is_the_first(tmp_path):
    named = names_of("mixed", 588_074, tmp_path)
    assert "iron_body" in named
    assert "second_iron_body" not in named


def names_of(kind: str, seed: int, folder: Path) -> set[str]:
    """Names that a diagnosis states in a hidden session."""
    draw_case(kind, seed, EFFECTS).write(folder)
    session = read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))
    return {named.cause.name for named in diagnose(session, seed=seed).causes}
