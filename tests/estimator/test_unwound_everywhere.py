"""A coil without a winding in all that uses a rig: live, in a batch, and in a recalibration."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from distributed import LocalCluster

from estimator.batching import batch
from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.inference.ensemble import SamplerSettings
from estimator.live.stream import Stream
from estimator.recalibration.widening import widened_rig
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.estimator.calibration.test_unwound import TEXT, in_ball, session_at

pytestmark = pytest.mark.whole

# Readings so noisy that they ask for no degree beyond the sixth.
COARSE = TEXT.replace("degree: 10", "degree: 6").replace("median: 3", "median: 50")
NOISE_T = 50e-6
UNIFORM = "c1.degree1_cos0_T_per_A"
SETTINGS = SamplerSettings(n_walkers=16, target_ess=200.0, largest_rhat=1.05)


def week(rig: Rig, seed: int, gain: float = 1.0) -> Session:
    """A session of the same magnet, as a sensor with that gain reads it."""
    session = session_at(rig, in_ball(150, seed), seed)
    noise_T = NOISE_T * torch.randn(150, 3, generator=torch.Generator().manual_seed(seed)).double()
    readings = session.observations
    return replace(session, observations=readings.with_field(gain * readings.field_sensor_T + noise_T))


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(COARSE)


@pytest.fixture(scope="module")
def current(rig: Rig) -> Calibration:
    return calibrate(week(rig, 1), settings=SETTINGS, seed=1)


def test_live_estimates_are_those_of_the_calibration(rig, current):
    stream, readings = Stream(rig), week(rig, 1).observations
    stream.update(readings.rows(torch.arange(120)))
    for rows in torch.arange(120, 150).split(10):
        last = stream.update(readings.rows(rows))
    assert (last.n_readings, stream.alarms) == (150, ())
    known = current.summary()["parameters"][UNIFORM]
    assert last.intervals[UNIFORM].value == pytest.approx(known["median"], abs=0.5 * known["sd"])
    assert last.intervals[UNIFORM].sd == pytest.approx(known["sd"], rel=0.2)


def test_a_batch_fits_each_session(rig, current, tmp_path):
    paths = [tmp_path / f"week{seed}.zarr" for seed in (1, 2)]
    for seed, path in zip((1, 2), paths, strict=True):
        week(rig, seed).save(path)
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
    ) as local:
        result = batch(paths, out=tmp_path / "out", has_posterior=False, scheduler=local.scheduler_address)
    known = current.summary()["parameters"][UNIFORM]
    assert result.failed == {}
    assert result.table()[UNIFORM].to_numpy() == pytest.approx(known["median"], abs=4.0 * known["sd"])


def test_a_rig_without_a_free_pose_has_priors_for_the_next_session(current, rig):
    prior = widened_rig(current, rig).parameters[UNIFORM].prior
    first = rig.parameters[UNIFORM].prior
    assert prior is not None
    assert first is not None
    assert current.draws[UNIFORM].std() <= prior.sd < first.sd
