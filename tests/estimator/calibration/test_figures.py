"""Pictures of a calibration: the ones a report needs, in an order that does not depend on where the calibration comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimator.calibration.figures import field_picture, pictures
from estimator.calibration.planes import coil_planes
from estimator.calibration.result import Calibration
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause

pytestmark = pytest.mark.whole


def titled(calibration: Calibration) -> dict:
    return {picture.title: picture.figure for picture in pictures(calibration)}


@pytest.fixture(scope="module")
def drawn(small_calibration: Calibration) -> dict:
    return titled(small_calibration)


def test_plane_of_the_field_follows_the_readings_but_not_to_where_the_field_is_a_dipoles(
    small_calibration, drawn
):
    low_mm, high_mm = drawn["Field of coil1"].axes[0].get_ylim()
    assert 50.0 < high_mm < 80.0  # the sensor is at most 6.5 cm in front of the coil
    far = small_calibration.observations.motion["arm1"].clone()
    far[:, 2] *= 50.0
    observations = replace(small_calibration.observations, motion={"arm1": far})
    ax = titled(replace(small_calibration, observations=observations))["Field of coil1"].axes[0]
    width_mm, (low_mm, high_mm) = np.ptp(ax.get_xlim()), ax.get_ylim()
    assert high_mm == pytest.approx(width_mm)
    assert low_mm > -1.2 * width_mm


def test_field_of_a_coil_is_without_that_of_the_room(small_calibration):
    """The Earth's field is no field per ampere, and its uncertainty is not the coil's."""
    room = Cause("background_field", "room")
    given = {"x_T": 1e-3, "y_T": 0.0, "z_T": 2e-3}
    rig = with_effect(small_calibration.rig, room, small_calibration.observations, given, is_free=False)
    best = {**small_calibration.best, **{f"{room.label}.{key}": value for key, value in given.items()}}
    calibrations = (small_calibration, replace(small_calibration, rig=rig, best=best))
    (alone,), (beside,) = map(coil_planes, calibrations)
    np.testing.assert_allclose(beside.field_T_per_A, alone.field_T_per_A, rtol=1e-9)
    np.testing.assert_allclose(beside.relative, alone.relative, rtol=1e-9)
    planes = [field_picture(each, "coil1").plot.args for each in calibrations]
    for of_one, of_other in zip(planes[0][2:4], planes[1][2:4], strict=True):
        np.testing.assert_allclose(of_one, of_other, rtol=1e-9)
