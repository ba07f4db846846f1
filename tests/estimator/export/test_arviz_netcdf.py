"""The posterior as ArviZ reads it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import arviz
import numpy as np
import pytest

from estimator.calibration.result import Calibration
from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text


def test_arviz_reads_draws_readings_and_units(magnet: Calibration, tmp_path: Path) -> None:
    data = arviz.from_netcdf(str(magnet.export("arviz", tmp_path / "magnet.nc")))
    assert set(data.posterior.data_vars) == set(magnet.draws)
    for name, draws in magnet.draws.items():
        np.testing.assert_array_equal(data.posterior[name], draws)
        assert data.posterior[name].attrs["units"] == magnet.rig.parameters[name].unit
    np.testing.assert_array_equal(data.sample_stats["lp"], magnet.log_prob)
    np.testing.assert_array_equal(data.observed_data["field_sensor_T"], magnet.observations.field_sensor_T)
    np.testing.assert_array_equal(data.constant_data["motion_arm"], magnet.observations.motion["arm"])
    assert rig_from_text(data.attrs["rig"]).name == magnet.rig.name


def test_posterior_without_a_free_parameter_is_refused(
    calibrated: Callable[[Rig], Calibration], small_rig: Rig, tmp_path: Path
) -> None:
    fixed = small_rig.with_fixed(parameter.name for parameter in small_rig.free)
    with pytest.raises(InvalidInput, match="must have a free parameter; rig 'small' has none"):
        calibrated(fixed).export("arviz", tmp_path / "magnet.nc")
