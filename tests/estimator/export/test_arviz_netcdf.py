"""The posterior as ArviZ reads it."""

from __future__ import annotations

import warnings

import arviz
import numpy as np
import pytest
from scipy import stats

from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.coordinates import nominal_tensors
from estimator.rig_files.read import rig_from_text


def test_arviz_reads_draws_readings_and_units(magnet, tmp_path):
    data = arviz.from_netcdf(str(magnet.export("arviz", tmp_path / "magnet.nc")))
    assert set(data.posterior.data_vars) == set(magnet.draws)
    for name, draws in magnet.draws.items():
        np.testing.assert_array_equal(data.posterior[name], draws)
        assert data.posterior[name].attrs["units"] == magnet.rig.parameters[name].unit
    np.testing.assert_array_equal(data.sample_stats["lp"], magnet.log_prob)
    np.testing.assert_array_equal(data.observed_data["field_sensor_T"], magnet.observations.field_sensor_T)
    np.testing.assert_array_equal(data.constant_data["motion_arm"], magnet.observations.motion["arm"])
    assert rig_from_text(data.attrs["rig"]).name == magnet.rig.name


def test_groups_hold_prior_predictions_and_likelihood_with_units(magnet, tmp_path):
    data = arviz.from_netcdf(str(magnet.export("arviz", tmp_path / "magnet.nc")))
    for name in magnet.draws:
        prior = magnet.rig.parameters[name].prior
        assert prior is not None
        drawn = data.prior[name].values
        assert abs(drawn.mean() - prior.centre) < 5.0 * prior.sd / np.sqrt(drawn.size)
        assert data.prior[name].attrs == data.posterior[name].attrs
    readings, (walkers, steps) = magnet.observations, magnet.log_prob.shape
    predicted = data.posterior_predictive["field_sensor_T"]
    assert predicted.dims == ("chain", "draw", "reading", "component")
    assert predicted.shape[0] == walkers
    assert predicted.attrs["units"] == data.observed_data["field_sensor_T"].attrs["units"] == "T"
    best = MeasurementModel.build(magnet.rig, readings).predict(magnet.best_values()).numpy()
    spread_T = predicted.std(("chain", "draw")).values
    assert (np.abs(predicted.mean(("chain", "draw")).values - best) < spread_T).all()
    assert (spread_T > 15e-6).all(), "the noise of the sensor is part of it"
    likelihood = data.log_likelihood["field_sensor_T"]
    last = {name: draws[-1, -1] for name, draws in magnet.draws.items()}
    rig = magnet.rig.with_values(last)
    fitted = readings.calibration
    field_T = MeasurementModel.build(rig, fitted).predict(nominal_tensors(rig)).numpy()
    measured_T = fitted.field_sensor_T.numpy()
    is_measured = ~np.isnan(measured_T)
    by_hand = stats.norm.logpdf(measured_T, field_T, 20e-6)[is_measured]
    np.testing.assert_allclose(likelihood.values[-1, -1], by_hand, rtol=1e-6)
    assert likelihood["draw"].values[-1] == steps - 1
    with warnings.catch_warnings():  # these draws are no chain
        warnings.simplefilter("ignore", UserWarning)
        assert np.isfinite(arviz.loo(data).elpd_loo)
    assert list(data.constant_data["coil"].values) == [coil.name for coil in magnet.rig.coils]
    assert data.constant_data["current_A"].attrs["units"] == "A"


def test_posterior_without_a_free_parameter_is_refused(calibrated, small_rig, tmp_path):
    fixed = small_rig.with_fixed(parameter.name for parameter in small_rig.free)
    with pytest.raises(InvalidInput, match="must have a free parameter; rig 'small' has none"):
        calibrated(fixed).export("arviz", tmp_path / "magnet.nc")
