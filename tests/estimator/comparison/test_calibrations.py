"""Two calibrations side by side: what was moved is seen, in its numbers and in its field, and what is the same is said to be."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from estimator.calibration.result import Calibration
from estimator.comparison.calibrations import side_by_side
from estimator.comparison.calibrations_report import sentences, side_by_side_report
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from tests.estimator.cli.conftest import run

Z = "coil1.world_from_coil0.z_m"


def moved(calibration: Calibration, z_m: float) -> Calibration:
    """The calibration with its coil elsewhere, from other readings."""
    summary = dict(calibration.summary())
    numbers = summary["parameters"][Z]
    summary["parameters"] = {**summary["parameters"], Z: {**numbers, "median": numbers["median"] + z_m}}
    summary["session_hash"] = "another"
    draws = {**calibration.draws, Z: calibration.draws[Z] + z_m}
    best = {**calibration.best, Z: calibration.best[Z] + z_m}
    return replace(calibration, best=best, draws=draws, summary_json=summary)


def test_a_coil_that_was_moved_is_seen_in_numbers_and_field(small_calibration):
    compared = side_by_side(small_calibration, moved(small_calibration, 1e-3), ("a", "b"))
    far = {pair.name for pair in compared.numbers if pair.distance_sd > 3.0}
    assert far == {Z}
    (plane,) = compared.planes
    # On the axis, the field changes by its slope times the way.
    column = np.argmin(np.abs(plane.x_m))
    along_T = plane.in_plane.field_T_per_A[:, column]
    slope_T_per_m = np.gradient(along_T, plane.z_m)
    outside = plane.z_m > 5e-3
    np.testing.assert_allclose(
        plane.in_plane.size_T_per_A[outside, column],
        1e-3 * np.abs(slope_T_per_m[outside]),
        rtol=0.1,
        atol=2e-7,
    )
    assert plane.at_readings.median_sds > 3.0
    told = sentences(compared)
    assert told[0].startswith("The fields of coil1 differ by ")
    assert any(Z in sentence for sentence in told)
    assert not any("same readings" in sentence for sentence in told)
    page = side_by_side_report(compared, "coilcal compare a b")
    assert page.count("data:image/png") == 1
    json.dumps(compared.to_json(), allow_nan=False)


def test_fields_are_compared_at_the_places_of_the_readings(small_calibration):
    """Beside the winding, where nobody measured, they differ by several times as much."""
    other = moved(small_calibration, 1e-3)
    observations = small_calibration.observations
    model = MeasurementModel.build(small_calibration.rig, observations)
    shown_T = [model.predict(each.best_values()) for each in (small_calibration, other)]
    is_on = observations.current_A[:, 0] != 0.0
    per_A = (shown_T[1] - shown_T[0])[is_on] / observations.current_A[is_on]
    (plane,) = side_by_side(small_calibration, other, ("a", "b")).planes
    expected = float(per_A.norm(dim=1).square().mean().sqrt())
    assert plane.at_readings.rms_T_per_A == pytest.approx(expected, rel=0.05)
    assert plane.in_plane.rms_T_per_A > 1.5 * expected


def test_a_calibration_does_not_differ_from_itself(small_calibration):
    compared = side_by_side(small_calibration, small_calibration, ("a", "a"))
    assert all(pair.distance_sd == 0.0 for pair in compared.numbers)
    assert compared.planes[0].at_readings.rms_T_per_A == 0.0
    assert "No number differs" in sentences(compared)[1]
    assert "same readings" in sentences(compared)[2]
    quality = {"verdict": "suspect", "reasons": ["halves disagree."], "next": ""}
    first, second = compared.calibrations
    doubtful = replace(second, summary_json={**second.summary_json, "quality": quality})
    told = sentences(replace(compared, calibrations=(first, doubtful)))
    assert told == [
        *sentences(compared),
        f"{compared.names[1]} is suspect: halves disagree. Intervals hold only if nothing is wrong.",
    ]
    side_by_side_report(compared, "")


def test_calibrations_without_a_common_coil_are_refused(small_calibration):
    rig = small_calibration.rig
    other = replace(rig, coils=(replace(rig.coils[0], name="coil9"),))
    with pytest.raises(InvalidInput, match="must have a coil in common; received coil1 and coil9"):
        side_by_side(small_calibration, replace(small_calibration, rig=other), ("a", "b"))


def test_the_command_takes_two_folders(small_calibration, tmp_path):
    small_calibration.save(tmp_path / "a")
    moved(small_calibration, 2e-3).save(tmp_path / "b")
    printed = run("compare", tmp_path / "a", tmp_path / "b", "--out", tmp_path / "out", "--json")
    record = json.loads(printed.stdout)
    assert record == json.loads((tmp_path / "out/comparison.json").read_text())
    assert record["fields"][0]["coil"] == "coil1"
    assert (tmp_path / "out/comparison.html").exists()
    refused = run("compare", tmp_path / "a", "--out", tmp_path / "other")
    assert "two calibrations are compared, or a session with the --map" in refused.stderr
