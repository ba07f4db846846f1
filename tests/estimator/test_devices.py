"""Every part of the path on another device and in single precision: no tensor of the processor slips in, and numbers stay the same."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from estimator.batching.stacked import stacked_fits
from estimator.calibration.calibrate import calibrate
from estimator.calibration.starting_point import starting_point_with_counts
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.fit_place import FitSetting, fitting_by
from estimator.diagnosis.fitting import fit_rig
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings, sample
from estimator.inference.likelihood import LogPosterior
from estimator.inference.positive_definite import inverse
from estimator.model.measurement_model import MeasurementModel
from estimator.model.preflight import check_precision
from estimator.model.room_field import RoomField
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates, nominal_tensors
from tests.far import far_device


def test_far_device_refuses_what_a_graphics_processor_refuses():
    with far_device() as far:
        x = torch.ones(3, dtype=torch.float64, device=far)
        assert (x + torch.tensor(1.0)).device == far
        with pytest.raises(RuntimeError):
            x + torch.ones(3, dtype=torch.float64)
        with pytest.raises(RuntimeError):
            torch.stack((x, torch.arange(3.0)))
        with pytest.raises(TypeError, match="numpy"):
            x.numpy()
        assert x.cpu().numpy().tolist() == [1.0, 1.0, 1.0]


@pytest.mark.whole
def test_fits_of_stacked_sessions_on_another_device(small_session):
    rig, readings = small_session.rig, small_session.observations.calibration
    random = torch.Generator().manual_seed(1)
    noise_T = 5e-6 * torch.randn(len(readings), 3, generator=random, dtype=torch.float64)
    sessions = [readings, readings.with_field(readings.field_sensor_T + noise_T)]
    near = stacked_fits(rig, sessions, [0, 1], 2)
    with far_device() as far:
        there = stacked_fits(rig, [session.to(far) for session in sessions], [0, 1], 2)
        for (_, here), (_, fit) in zip(near, there, strict=True):
            assert fit.vector.device == far
            assert_close(fit.vector.cpu(), here.vector, rtol=1e-9, atol=1e-12)
            assert_close(inverse(fit.precision).cpu(), inverse(here.precision), rtol=1e-7, atol=0.0)


@pytest.mark.whole
def test_stacked_fits_climb_elsewhere_and_take_their_last_step_at_home(small_session):
    rig, readings = small_session.rig, small_session.observations.calibration
    sessions = [readings, readings.with_field(1.001 * readings.field_sensor_T)]
    near = stacked_fits(rig, sessions, [0, 1], 2)
    with far_device() as far:
        for precision in ("double", "single"):
            there = stacked_fits(rig, sessions, [0, 1], 2, str(far), precision)
            for (_, here), (_, fit) in zip(near, there, strict=True):
                assert fit.vector.device.type == "cpu"
                sd = inverse(here.precision)[0].diagonal().sqrt()
                assert float(((fit.vector - here.vector)[0] / sd).abs().max()) < 0.01
                assert float((fit.log_posterior - here.log_posterior).abs()) < 1e-3


@pytest.mark.slow
@pytest.mark.whole
def test_point_estimate_counts_and_chain_on_another_device(small_session):
    rig, readings = small_session.rig, small_session.observations.calibration

    def results(readings: Observations) -> tuple[torch.Tensor, np.ndarray]:
        posterior = LogPosterior(Coordinates(rig), MeasurementModel.build(rig, readings), readings)
        start = starting_point_with_counts(
            posterior,
            readings,
            0,
            lambda p: LogPosterior(Coordinates(rig, True), p.model, readings),
            lambda name, undetermined: None,
        )
        settings = SamplerSettings(max_steps=20, check_every=20)
        return start.estimate.vector.cpu(), sample(start.posterior, start.mixture, settings).chain[0]

    near_vector, near_walkers = results(readings)
    with far_device() as far:
        far_vector, far_walkers = results(readings.to(far))
    assert_close(far_vector, near_vector, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(far_walkers, near_walkers, rtol=1e-5)


@pytest.mark.whole
def test_field_of_the_room_on_another_device_and_in_single_precision(small_session):
    rig = small_session.rig
    points_m = torch.tensor([[0.0, 0.0, 0.05], [0.1, 0.02, 0.3], [0.0, 0.2, -1.0]], dtype=torch.float64)

    def field_T(points_m: torch.Tensor) -> torch.Tensor:
        values = nominal_tensors(rig, points_m)
        return RoomField(rig, values, points_m).field_T(values, points_m.new_ones(len(rig.coils)))

    near_T = field_T(points_m)
    assert_close(field_T(points_m.float()).double(), near_T, rtol=1e-5, atol=1e-14)
    with far_device() as far:
        assert_close(field_T(points_m.to(far)).cpu(), near_T, rtol=1e-11, atol=1e-20)


@pytest.mark.whole
def test_single_precision_finds_the_maximum_within_a_hundredth_of_its_standard_deviation(small_session):
    rig, readings = small_session.rig, small_session.observations.calibration
    check_precision(rig, readings)
    (_, double), (_, single) = (
        stacked_fits(rig, [each], [0], 2)[0] for each in (readings, readings.to(dtype=torch.float32))
    )
    sd = inverse(double.precision)[0].diagonal().sqrt()
    assert single.vector.dtype == torch.float64
    assert bool(single.is_converged.all())
    assert float(((single.vector - double.vector).abs()[0] / sd).max()) < 0.01
    assert float((single.log_posterior - double.log_posterior).abs()) < 0.05


def test_single_precision_is_refused_where_it_would_be_seen(small_session):
    strong = replace(small_session.observations, current_A=2e4 * small_session.observations.current_A)
    with pytest.raises(InvalidInput, match="precision must be double for fields this large"):
        check_precision(small_session.rig, strong)


@pytest.mark.whole
def test_fit_of_a_diagnosis_climbs_elsewhere_and_ends_as_on_the_processor(small_session):
    rig, readings = small_session.rig, small_session.observations.calibration
    rules = MeasurementModel.build(rig, readings).rules
    near = fit_rig(rig, readings, {}, rules)
    moved = list[torch.device]()
    with far_device() as far:
        for dtype in (torch.float64, torch.float32):
            with fitting_by(FitSetting(place=(far, dtype))):
                there = fit_rig(rig, readings, {}, rules)
            moved.append(there.vector.device)
            assert there.log_evidence == pytest.approx(near.log_evidence, abs=1e-3)
            assert float(((there.vector - near.vector) ** 2 / near.covariance.diagonal()).max()) < 1e-4
    assert set(moved) == {torch.device("cpu")}


@pytest.mark.whole
def test_prediction_of_a_calibration_on_another_device_and_in_single_precision(small_calibration):
    points_m = torch.tensor([[0.0, 0.0, 0.05], [0.1, 0.02, 0.3], [0.0, 0.2, -1.0]], dtype=torch.float64)
    currents_A = {small_calibration.rig.coils[0].name: 3.0}

    def answer(points_m: torch.Tensor) -> torch.Tensor:
        field_T = small_calibration.field(points_m, currents_A)
        ends_T = small_calibration.field_interval(points_m, currents_A)
        assert field_T.device == ends_T[0].device == points_m.device
        return torch.stack((field_T, *ends_T))

    near_T = answer(points_m)
    assert_close(answer(points_m.float()).double(), near_T, rtol=1e-4, atol=1e-12)
    with far_device() as far:
        assert_close(answer(points_m.to(far)).cpu(), near_T, rtol=1e-9, atol=1e-18)


def test_device_that_is_not_there_is_refused(small_session):
    with pytest.raises(InvalidInput, match="device must be one that torch can compute on here"):
        calibrate(small_session, device="xpu:7")
    with pytest.raises(InvalidInput, match="precision must be one of double, single"):
        calibrate(small_session, precision="half")
    with pytest.raises(InvalidInput, match="device must be one that torch can compute on here"):
        diagnose(small_session, device="xpu:7")


def test_readings_keep_their_history_and_the_precision_of_times(small_session):
    readings = small_session.observations.calibration
    assert readings.to("cpu", torch.float64) is readings
    single = readings.to(dtype=torch.float32)
    assert (single.current_A.dtype, single.time_s.dtype) == (torch.float32, torch.float64)
    assert len(single.history) == len(readings.history)
    assert single.history.current_A.dtype == torch.float32
