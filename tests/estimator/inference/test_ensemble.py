"""Sampling: the right law from any proposal, the same chain from the same seed, and an honest stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from emcee.backends import Backend

from estimator.errors import InvalidInput
from estimator.inference.ensemble import Progress, SamplerSettings, Samples, reported_parameters, sample
from estimator.inference.lattice import CountMixture, count_mixture
from estimator.inference.levenberg_marquardt import levenberg_marquardt
from estimator.store.emcee_backend import ZarrBackend

NEVER = 1e9  # an effective sample size that no chain reaches


@pytest.fixture(scope="module")
def mixture(counts_problem) -> CountMixture:
    fit = levenberg_marquardt(counts_problem.real, counts_problem.real.coordinates.start()[None])
    laplace_mixture = count_mixture(counts_problem.real, counts_problem.whole, fit, np.random.default_rng(0))
    assert laplace_mixture is not None
    return laplace_mixture


@pytest.fixture(scope="module")
def samples(counts_problem, mixture) -> Samples:
    return sample(counts_problem.whole, mixture, SamplerSettings(n_walkers=32, target_ess=3000.0, seed=1))


def steps_of(counts_problem, mixture: CountMixture, **settings) -> Samples:
    """A short chain that no target ends."""
    chosen = SamplerSettings(
        **{"n_walkers": 12, "target_ess": NEVER, "check_every": 10, "max_steps": 30} | settings
    )
    return sample(counts_problem.whole, mixture, chosen)


def assert_law(samples: Samples, counts_problem, exact_counts) -> None:
    """Probabilities of counts, and moments of gain and height, within 4 standard errors of what they are."""
    coordinates = counts_problem.whole.coordinates
    chain = reported_parameters(coordinates, samples.chain)
    by_name = {name: chain[..., i] for i, name in enumerate(coordinates.names)}
    ess = samples.convergence.smallest_ess
    for (axial, radial), p in exact_counts.probability.items():
        if p > 1e-3:
            here = (by_name["coil1.axial_loops"] == axial) & (by_name["coil1.radial_loops"] == radial)
            assert abs(here.mean() - p) < 4.0 * np.sqrt(p * (1.0 - p) / ess), (axial, radial)
    gain, z_m = by_name["coil1.current_gain"], by_name["coil1.world_from_coil.z_m"]
    assert abs(gain.mean() - exact_counts.gain_mean) < 4.0 * gain.std() / np.sqrt(ess)
    assert abs(z_m.mean() - exact_counts.z_mean_m) < 4.0 * z_m.std() / np.sqrt(ess)
    assert z_m.std() == pytest.approx(exact_counts.z_sd_m, rel=0.1)


def test_chain_has_the_law_of_the_posterior(samples, counts_problem, exact_counts):
    assert samples.is_converged
    assert_law(samples, counts_problem, exact_counts)
    assert samples.acceptance > 0.5


def test_a_wrong_proposal_is_put_right_before_sampling(samples, counts_problem, mixture, exact_counts):
    """Every maximum off by a standard deviation in each principal direction, and every covariance doubled."""
    shift = torch.linalg.cholesky(mixture.covariance).sum(-1)
    wrong = replace(mixture, mean=mixture.mean + shift, covariance=2.0 * mixture.covariance)
    settings = SamplerSettings(n_walkers=16, target_ess=800.0, largest_rhat=1.03, seed=1)
    adapted = sample(counts_problem.whole, wrong, settings)
    assert adapted.is_converged
    assert_law(adapted, counts_problem, exact_counts)
    efficiency = [run.convergence.smallest_ess / run.log_prob.size for run in (adapted, samples)]
    assert efficiency[0] > 0.7 * efficiency[1]


def test_sampling_stops_at_the_first_look_that_meets_its_targets(samples):
    assert samples.convergence.smallest_ess >= 3000.0
    assert samples.convergence.largest_rhat <= 1.01
    assert samples.n_steps < 5000
    assert samples.n_steps % SamplerSettings().check_every == 0
    assert (
        len(samples.chain) == len(samples.log_prob) == samples.n_steps - samples.n_steps // 10
    )  # a tenth is burn-in


@pytest.mark.parametrize("target", [{"target_ess": NEVER}, {"target_ess": 1.0, "largest_rhat": 1.0 - 1e-9}])
def test_unmet_targets_are_reported(counts_problem, mixture, target):
    samples = steps_of(counts_problem, mixture, **target)
    assert not samples.is_converged
    assert samples.n_steps == 30


def test_log_prob_belongs_to_the_chain(samples, counts_problem):
    some = slice(None, None, 97)
    expected = counts_problem.whole(torch.from_numpy(samples.chain[some]))
    np.testing.assert_allclose(samples.log_prob[some], expected.numpy(), rtol=1e-10)


def test_same_seed_gives_the_same_chain_and_another_seed_another(counts_problem, mixture):
    first, again, other_seed = (steps_of(counts_problem, mixture, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.chain, again.chain)
    np.testing.assert_array_equal(first.log_prob, again.log_prob)
    assert (first.chain[..., 0] != other_seed.chain[..., 0]).all()


def test_seed_is_all_that_decides(counts_problem, mixture):
    np.random.seed(1)  # noqa: NPY002 - emcee and SciPy know this one
    first = steps_of(counts_problem, mixture)
    np.random.seed(2)  # noqa: NPY002
    torch.manual_seed(2)
    np.testing.assert_array_equal(first.chain, steps_of(counts_problem, mixture).chain)


class Killed(Exception):
    """What ends a run in the middle."""


@pytest.mark.parametrize("killed_at", [10, 20, 30])
def test_killed_run_continues_to_the_chain_of_the_uninterrupted_one(
    counts_problem, mixture, tmp_path, killed_at
):
    settings = SamplerSettings(n_walkers=12, target_ess=NEVER, check_every=10, max_steps=50, seed=5)
    expected = sample(counts_problem.whole, mixture, settings)

    def kill(progress: Progress) -> None:
        if progress.step >= killed_at:
            raise Killed

    path = tmp_path / "chain.zarr"
    backend = ZarrBackend.create(
        path, coordinate_names=list("abcd"), n_walkers=12, checkpoint_steps=4, fingerprint="test"
    )
    with pytest.raises(Killed):
        sample(counts_problem.whole, mixture, settings, backend, kill)
    reopened = ZarrBackend.open(path, fingerprint="test")
    assert 0 < reopened.iteration <= killed_at
    continued = sample(counts_problem.whole, mixture, settings, reopened)
    np.testing.assert_array_equal(continued.chain, expected.chain)
    np.testing.assert_array_equal(continued.log_prob, expected.log_prob)
    assert continued.n_steps == expected.n_steps == 50


def test_killed_run_stops_where_the_uninterrupted_one_does(counts_problem, mixture):
    """Which checkpoints have a look depends on earlier looks, so a continued run makes those again."""
    settings = SamplerSettings(n_walkers=12, target_ess=700.0, largest_rhat=1.1, check_every=10, seed=5)
    expected = sample(counts_problem.whole, mixture, settings)
    assert expected.is_converged

    def kill(progress: Progress) -> None:
        if progress.step >= expected.n_steps - 20:
            raise Killed

    backend = Backend()
    with pytest.raises(Killed):
        sample(counts_problem.whole, mixture, settings, backend, kill)
    continued = sample(counts_problem.whole, mixture, settings, backend)
    np.testing.assert_array_equal(continued.chain, expected.chain)


def test_chain_longer_than_its_targets_ask_for_is_returned_whole(counts_problem, mixture):
    backend = Backend()
    settings = SamplerSettings(n_walkers=12, target_ess=NEVER, check_every=10, max_steps=300)
    sample(counts_problem.whole, mixture, settings, backend)
    again = sample(
        counts_problem.whole, mixture, replace(settings, target_ess=50.0, largest_rhat=1.5), backend
    )
    assert again.is_converged
    assert again.n_steps == 300


def test_finished_chain_is_looked_at_again_and_not_prolonged(counts_problem, mixture):
    backend = Backend()
    settings = SamplerSettings(n_walkers=12, target_ess=NEVER, check_every=10, max_steps=30)
    first = sample(counts_problem.whole, mixture, settings, backend)
    for max_steps in (30, 20):
        again = sample(counts_problem.whole, mixture, replace(settings, max_steps=max_steps), backend)
        assert again.n_steps == 30
        np.testing.assert_array_equal(again.chain, first.chain)
    longer = sample(counts_problem.whole, mixture, replace(settings, max_steps=40), backend)
    assert longer.n_steps == 40
    np.testing.assert_array_equal(longer.chain[: 40 - 8], backend.get_chain()[4:36])


def test_walkers_start_inside_the_prior(counts_problem, mixture):
    """Two thirds of this proposal lie where a negative number of ... gain is cut off by the prior's bound."""
    samples = steps_of(counts_problem, mixture, max_steps=1, check_every=1)
    assert np.isfinite(samples.log_prob).all()


def test_too_few_walkers_are_refused(counts_problem, mixture):
    with pytest.raises(InvalidInput, match=r"walkers must be at least 8 for 4 free parameters; received 7"):
        steps_of(counts_problem, mixture, n_walkers=7)


def test_reported_chain_holds_the_free_parameters_in_their_order(counts_problem):
    coordinates = counts_problem.real.coordinates
    vectors = coordinates.sample_prior(np.random.default_rng(6), 6).reshape(2, 3, -1)
    chain = reported_parameters(coordinates, vectors.numpy())
    for i, name in enumerate(coordinates.names):
        np.testing.assert_array_equal(chain[..., i], coordinates.values(vectors)[name].numpy())
