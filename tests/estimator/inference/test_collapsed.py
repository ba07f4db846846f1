"""Amplitudes integrated out of a posterior: against ridge regression in NumPy, and against emcee over everything."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats

from estimator.calibration.starting_point import is_collapsible, starting_point_collapsed
from estimator.inference.collapsed import CollapsedPosterior
from estimator.inference.collapsed_estimate import collapsed_estimate
from estimator.inference.ensemble import SamplerSettings, reported_parameters, sample
from estimator.inference.lattice import laplace_mixture
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.inference.likelihood import LogPosterior
from estimator.model.coil_field import unwound_field
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates, nominal_tensors
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from tests.far import far_device

NOISE_T = 5e-6
SD, FALLOFF = 1e-3, 0.5
NOISE = "noise_uT: {prior: {log_normal: {median: 10, relative_sd: 1}}}"
TEXT = f"""
schema_version: 1
name: box
movers: {{stage: {{motion: pose}}}}
coils:
  c1:
    model: harmonic
    region: interior
    degree: 2
    reference_radius_mm: 50
    amplitudes: {{sd_T_per_A: {SD}, falloff: {FALLOFF}}}
sensors: {{hall: {{carried_by: stage, {NOISE}}}}}
"""
FREE_GAIN = TEXT.replace(
    "carried_by: stage,", "carried_by: stage, gain: {prior: {normal: {mean: 1, sd: 0.01}}},"
)
TWO_SENSORS = TEXT.replace("sensors: {", f"sensors: {{second: {{carried_by: stage, {NOISE}}}, ")
TIED = TEXT.replace(
    "sensors:",
    "  c2: {model: harmonic, region: interior, degree: 1, reference_radius_mm: 50, amplitudes: {sd_T_per_A: 1e-3,"
    " degree1_cos1_T_per_A: {tied_to: c1.degree1_cos1_T_per_A, factor: -2}}}\nsensors:",
)
OUTLIERS = TEXT + 'effects: {"outliers[hall]": {share: 0.05, ratio: 10}}\n'


def problem(text: str, n: int = 25, seed: int = 0) -> tuple[Rig, Observations]:
    """A rig and readings of random amplitudes at random places, half of them at one current and half at another."""
    rig, rng = rig_from_text(text), np.random.default_rng(seed)
    n_sensors, n_coils = len(rig.sensors), len(rig.coils)
    pose = np.concatenate((rng.uniform(-0.03, 0.03, (n, 3)), np.zeros((n, 3))), 1)
    current = rng.choice([1.0, -2.0], (n, n_coils))
    observations = Observations.of(
        torch.from_numpy(current),
        {"stage": torch.from_numpy(pose)},
        torch.zeros(n, 3).double(),
        sensor=torch.from_numpy(rng.integers(n_sensors, size=n)),
    )
    truth = {p.name: float(rng.normal(0.0, p.prior.sd)) for p in rig.free if p.unit == "T/A" and p.prior}
    values = nominal_tensors(rig.with_values(truth))
    field_T = MeasurementModel.build(rig, observations).predict(values)
    readings_T = field_T + torch.from_numpy(rng.normal(0.0, NOISE_T, (n, 3)))
    readings_T[0, 1] = torch.nan  # a component that was not measured
    return rig, replace(observations, field_sensor_T=readings_T)


def full_posterior(rig: Rig, observations: Observations) -> LogPosterior:
    return LogPosterior(Coordinates(rig), MeasurementModel.build(rig, observations), observations)


def test_noise_does_not_vanish_where_readings_leave_combinations_of_amplitudes_open():
    """168 amplitudes and 74 components: most combinations move no reading, and their rounding is no evidence."""
    rig, observations = problem(TEXT.replace("degree: 2", "degree: 12"))
    posterior = CollapsedPosterior(full_posterior(rig, observations))
    start = posterior.coordinates.start()
    below = start - torch.arange(0.0, 200.0, 5.0)[:, None]  # logarithms of the noise
    log_evidence = posterior.log_likelihood(below)
    assert torch.isfinite(log_evidence).all()
    assert log_evidence[-1] < log_evidence.max() - 50.0
    assert torch.argmax(log_evidence) < 3


def design(rig: Rig, observations: Observations) -> np.ndarray:
    """Change of each component per amplitude of c1, without the model of measurement."""
    coil = rig.unwound[0]
    names = [name for own in coil.amplitudes.values() for name in own]
    each = torch.eye(len(names), dtype=torch.float64)
    values = nominal_tensors(rig) | {name: each[i] for i, name in enumerate(names)}
    field = unwound_field(coil, values).by(None)(observations.motion["stage"][:, :3])
    return (field * observations.current_A[:, :1]).flatten(1).T.numpy()


def marginal_of(columns: np.ndarray, sd: np.ndarray) -> stats.rv_continuous:
    """Normal distribution of the readings, averaged over the amplitudes' priors."""
    covariance = NOISE_T**2 * np.eye(len(columns)) + (columns * sd**2) @ columns.T
    return stats.multivariate_normal(np.zeros(len(columns)), covariance)


def test_amplitudes_and_evidence_are_those_of_ridge_regression():
    rig, observations = problem(TEXT)
    measured_T, columns = observations.field_sensor_T.numpy().ravel(), design(rig, observations)
    is_measured = np.isfinite(measured_T)
    y, x = measured_T[is_measured], columns[is_measured]
    sd = np.repeat([SD, SD * FALLOFF], [3, 5])
    covariance = np.linalg.inv(x.T @ x / NOISE_T**2 + np.diag(sd**-2.0))
    mean = covariance @ x.T @ y / NOISE_T**2
    collapsed = CollapsedPosterior(full_posterior(rig, observations))
    at = collapsed.coordinates.vector({"hall.noise_T": NOISE_T})
    best = collapsed.values(at)
    np.testing.assert_allclose([float(best[name]) for name in collapsed.amplitudes], mean, rtol=1e-9)
    prior = rig.parameters["hall.noise_T"].prior
    assert prior is not None
    expected = (
        marginal_of(x, sd).logpdf(y)
        + float(prior.log_density(torch.tensor(NOISE_T).double()))
        + np.log(NOISE_T)
    )
    assert float(collapsed(at[None])[0]) == pytest.approx(expected, rel=1e-10)
    given = torch.linalg.inv(collapsed.given(at).precision).numpy() * sd[:, None] * sd
    np.testing.assert_allclose(given, covariance, rtol=1e-8, atol=1e-25)
    assert float(collapsed.log_likelihood(at[None])[0]) == pytest.approx(
        marginal_of(x, sd).logpdf(y), rel=1e-10
    )
    draws = collapsed.drawn(at.expand(4000, 5, 1).numpy(), seed=1)
    drawn = np.stack([draws[name].ravel() for name in collapsed.amplitudes])
    np.testing.assert_allclose(drawn.mean(1), mean, atol=4 * np.sqrt(np.diag(covariance) / 20_000).max())
    np.testing.assert_allclose(np.cov(drawn), covariance, atol=0.04 * np.diag(covariance).max())


@pytest.mark.parametrize("text", [TEXT, TWO_SENSORS])
def test_sums_over_readings_say_the_same_as_the_readings(text):
    rig, observations = problem(text)
    by_sums = CollapsedPosterior(full_posterior(rig, observations))
    by_readings = CollapsedPosterior(full_posterior(rig, observations))
    assert by_sums._is_only_noise
    by_readings._is_only_noise = False
    rows = by_sums.coordinates.sample_prior(np.random.default_rng(0), 4)
    torch.testing.assert_close(by_sums(rows), by_readings(rows))
    for one, other in zip(by_sums.given(rows[0]), by_readings.given(rows[0]), strict=True):
        torch.testing.assert_close(one, other, rtol=1e-9, atol=1e-12)
    chain = rows.expand(2000, 4, -1).numpy()
    first, second = by_sums.drawn(chain, 1), by_readings.drawn(chain, 2)
    for name in by_sums.amplitudes:
        assert first[name].mean(0) == pytest.approx(second[name].mean(0), abs=0.15 * first[name].std(0).max())
        assert first[name].std(0) == pytest.approx(second[name].std(0), rel=0.15)


@pytest.mark.whole
def test_everything_sampled_by_emcee_has_the_same_posterior():
    rig, observations = problem(FREE_GAIN, n=12)
    full = full_posterior(rig, observations)
    collapsed = CollapsedPosterior(full)
    assert not collapsed._is_only_noise
    estimate = collapsed_estimate(collapsed, observations, 0)
    settings = SamplerSettings(target_ess=400.0, max_steps=600)
    short = sample(collapsed, laplace_mixture(estimate.fit, 0), settings)
    rest = reported_parameters(collapsed.coordinates, short.chain)
    drawn = {name: rest[:, :, i] for i, name in enumerate(collapsed.coordinates.names)}
    drawn |= collapsed.drawn(short.chain, 1)
    best = full.coordinates.vector(collapsed.values(estimate.vector))
    fit = levenberg_marquardt(full, best[None])
    long = sample(full, laplace_mixture(fit, 0), SamplerSettings(target_ess=400.0, max_steps=3000))
    assert short.is_converged
    assert long.is_converged
    everything = reported_parameters(full.coordinates, long.chain)
    for i, name in enumerate(full.coordinates.names):
        expected, received = everything[:, :, i], drawn[name]
        assert received.mean() == pytest.approx(expected.mean(), abs=0.15 * expected.std()), name
        assert received.std() == pytest.approx(expected.std(), rel=0.12), name


def test_a_millionth_of_noise_leaves_digits_for_the_density():
    """Readings of 1 mT with noise of 1 nT: about zero their squares would be 1e12."""
    rig, observations = problem(TEXT.replace("median: 10", "median: 0.001"))
    exact = CollapsedPosterior(full_posterior(rig, observations))
    fit_T = exact.full.model.predict(exact.values(exact.coordinates.start()))
    quiet = torch.from_numpy(np.random.default_rng(0).normal(0.0, 1e-9, (25, 3)))
    observations = replace(observations, field_sensor_T=fit_T.detach() + quiet)
    collapsed = CollapsedPosterior(full_posterior(rig, observations))
    vector = collapsed.coordinates.vector({"hall.noise_T": 1e-9})
    around = vector + 1e-5 * torch.arange(-5.0, 6.0, dtype=torch.float64)[:, None]
    values = collapsed(around)
    curved = values[2:] - 2.0 * values[1:-1] + values[:-2]
    assert float(curved.abs().max()) < 1e-6  # a smooth curve; rounding would show as scatter


def test_the_maximum_is_no_lower_than_any_point_about_it():
    rig, observations = problem(FREE_GAIN)
    collapsed = CollapsedPosterior(full_posterior(rig, observations))
    estimate = collapsed_estimate(collapsed, observations, 0)
    assert bool(estimate.fit.is_converged[0])
    sd = torch.diagonal(estimate.fit.precision[0]).rsqrt()
    around = (
        estimate.vector + 0.3 * sd * torch.randn(40, 2, generator=torch.Generator().manual_seed(0)).double()
    )
    assert (collapsed(around) < estimate.fit.log_posterior[0]).all()
    assert estimate.fit.log_posterior[0] == collapsed(estimate.vector[None])[0]


def test_what_is_tied_to_an_amplitude_follows_it():
    rig, observations = problem(TIED)
    collapsed = CollapsedPosterior(full_posterior(rig, observations))
    best = collapsed.values(collapsed.coordinates.start())
    assert float(best["c2.degree1_cos1_T_per_A"]) == -2.0 * float(best["c1.degree1_cos1_T_per_A"]) != 0.0
    misfit_T = collapsed.full.model.predict(best) - observations.field_sensor_T
    assert float(misfit_T.nan_to_num().square().mean().sqrt()) < 2.0 * NOISE_T


def test_readings_that_do_not_scatter_normally_are_left_to_the_sampler():
    for text, is_linear in ((TEXT, True), (FREE_GAIN, True), (OUTLIERS, False)):
        assert CollapsedPosterior(full_posterior(*problem(text))).is_linear is is_linear


def test_outside_the_prior_there_is_no_density():
    rig, observations = problem(TEXT.replace("relative_sd: 1", "relative_sd: 1, lower: 1"))
    collapsed = CollapsedPosterior(full_posterior(rig, observations))
    inside, outside = (collapsed.coordinates.vector({"hall.noise_T": noise_T}) for noise_T in (NOISE_T, 1e-7))
    values = collapsed(torch.stack((inside, outside, inside)))
    assert torch.isfinite(values).tolist() == [True, False, True]
    assert values[0] == values[2]


@pytest.mark.parametrize(
    "text", [*(pytest.param(text, marks=pytest.mark.slow) for text in (TEXT, FREE_GAIN, TIED)), TWO_SENSORS]
)
def test_amplitudes_are_integrated_out_on_another_device_as_on_the_processor(text):
    """Design matrix, maximum, chain, draws of the amplitudes given it, and the evidence for a degree more."""
    rig, readings = problem(text)
    settings = SamplerSettings(n_walkers=16, max_steps=10, check_every=10)

    def results(readings: Observations) -> tuple[dict[str, float], dict[str, np.ndarray], dict[str, Any]]:
        posterior = full_posterior(rig, readings)
        assert is_collapsible(posterior)
        start = starting_point_collapsed(posterior, readings, 0)
        assert start.estimate.vector.device == readings.device
        chain = sample(start.posterior, start.mixture, settings).chain
        return start.best(), start.draws(chain, 1), start.summary(readings)

    best, draws, said = results(readings)
    with far_device() as far:
        far_best, far_draws, far_said = results(readings.to(far))
    assert far_best == pytest.approx(best, rel=1e-6, abs=1e-12)
    for name, values in draws.items():
        np.testing.assert_allclose(far_draws[name], values, rtol=1e-6, atol=1e-6 * values.std())
    assert far_said["amplitudes"] == said["amplitudes"]
    assert far_said["next_degree_log_evidence"] == pytest.approx(said["next_degree_log_evidence"], abs=1e-6)


@pytest.mark.parametrize("text", [TEXT, FREE_GAIN, TWO_SENSORS, TIED])
@pytest.mark.parametrize("is_collapsed", [False, True])
def test_densities_answer_alike_whether_or_not_amplitudes_are_integrated_out(text, is_collapsed):
    rig, observations = problem(text)
    full = LogPosterior(Coordinates(rig), MeasurementModel.build(rig, observations), observations)
    density = CollapsedPosterior(full) if is_collapsed else full
    start = density.coordinates.start()
    torch.testing.assert_close(density(start), density(start.expand(2, 3, -1))[1, 2], rtol=1e-12, atol=0.0)
    assert set(density.values(start)) == set(rig.parameters)
    chain = start.expand(4, 2, -1).numpy()
    drawn = density.drawn(chain, seed=1)
    assert set(drawn) == set(density.amplitudes)
    assert {*drawn, *density.coordinates.names} == {parameter.name for parameter in rig.free}
