"""Posterior sampling with emcee: all walkers in one batched call, with checkpoints, until the diagnostics reach their targets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import emcee
import numpy as np
import torch
from emcee.backends import Backend

from estimator.devices import numpy_of
from estimator.errors import InvalidInput
from estimator.inference.adaptation import adapted
from estimator.inference.convergence import Convergence, convergence
from estimator.inference.density import Density
from estimator.inference.lattice import CountMixture
from estimator.inference.moves import GOOD_SHARES, POOR_SHARES, MovesInBlocks
from estimator.inference.proposal import MixtureProposal
from estimator.rig.coordinates import Coordinates

BURN_IN_SHARE = 0.1
FEWEST_WALKERS = 32
GOOD_EFFICIENCY = 0.5  # of a proposal that hardly needs the other moves
# Diagnostics are computed at the first checkpoint, from this share of the target effective samples on, and when chains have grown so much.
LOOK_FROM, OLD_LOOK = 0.95, 4.0


@dataclass(frozen=True)
class SamplerSettings:
    """How long to sample.

    Attributes:
        n_walkers: Walkers in the ensemble; 0 stands for 32, or for two per free parameter if that is more. Many short chains need more
            samples until R-hat is small.
        target_ess: Effective sample size (bulk and tail) that every coordinate must reach.
        largest_rhat: R-hat that every coordinate must fall below.
        max_steps: Sampling stops here, converged or not.
        check_every: Fewest steps between two looks at the diagnostics, which are also the checkpoints.
        seed: Seed of the random state; the same seed gives the same chain on the same machine.
    """

    n_walkers: int = 0
    target_ess: float = 2000.0
    largest_rhat: float = 1.01
    max_steps: int = 20_000
    check_every: int = 50
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("target_ess", "largest_rhat", "max_steps", "check_every"):
            if not getattr(self, name) > 0:
                raise InvalidInput(f"sampler settings: {name} must be > 0; received {getattr(self, name)}")
        if not 0 <= self.seed < 2**32:
            raise InvalidInput(f"seed must be a whole number from 0 to {2**32 - 1}; received {self.seed}")

    def for_rig(self, n_free: int) -> SamplerSettings:
        """These settings with enough walkers for the moves: at least two per dimension, and two more than dimensions.

        Raises:
            InvalidInput: The settings ask for fewer.
        """
        fewest = max(2 * n_free, n_free + 2)
        if self.n_walkers == 0:
            return replace(self, n_walkers=max(FEWEST_WALKERS, fewest))
        if self.n_walkers < fewest:
            raise InvalidInput(
                f"walkers must be at least {fewest} for {n_free} free parameters; received {self.n_walkers}"
            )
        return self


@dataclass(frozen=True)
class Progress:
    """Diagnostics of a running chain against their targets; effective samples are extrapolated from the last look at them."""

    step: int
    max_steps: int
    smallest_ess: float
    target_ess: float
    largest_rhat: float


@dataclass(frozen=True)
class Samples:
    """The chain after burn-in with its diagnostics.

    Attributes:
        chain: Coordinates, with axes step, walker and coordinate.
        log_prob: Log posterior density, with axes step and walker.
        is_converged: The targets were met; otherwise the chain ended at `max_steps`.
        acceptance: Mean acceptance fraction.
        n_steps: Steps taken, burn-in included.
    """

    chain: np.ndarray
    log_prob: np.ndarray
    convergence: Convergence
    is_converged: bool
    acceptance: float
    n_steps: int


def sample(
    posterior: Density,
    mixture: CountMixture,
    settings: SamplerSettings,
    backend: Backend | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Samples:
    """Sample the posterior until effective sample size and R-hat reach their targets.

    The proposal is the Laplace mixture, fitted to the posterior by weighted draws where it is far from it. Walkers start from its draws;
    the first tenth of the steps is dropped. A backend that already holds steps is continued.

    Args:
        posterior: Density over coordinates with whole-numbered counts in the last columns.
        mixture: Laplace mixture, from which the proposal of the independence move is fitted.
        settings: Targets and limits.
        backend: emcee backend; in memory by default.
        on_progress: Called at every checkpoint.
    Returns: The chain; `is_converged` is False if `max_steps` came first.
    Raises:
        InvalidInput: Too few walkers for the number of coordinates.
    References: Foreman-Mackey et al., PASP 125, 306 (2013).
    """

    def log_prob(vectors: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return numpy_of(posterior(torch.from_numpy(vectors).to(posterior.coordinates.device)))

    proposal, efficiency = adapted(MixtureProposal(mixture), log_prob, np.random.RandomState(settings.seed))
    backend = backend if backend is not None else Backend()
    moves = MovesInBlocks(
        proposal,
        settings.seed,
        backend.iteration if backend.initialized else 0,
        GOOD_SHARES if efficiency >= GOOD_EFFICIENCY else POOR_SHARES,
    )
    n = posterior.coordinates.n
    settings = settings.for_rig(n)
    sampler = emcee.EnsembleSampler(
        settings.n_walkers, n, log_prob, moves=moves, vectorize=True, backend=backend
    )
    state = _initial_state(log_prob, proposal, settings, backend)
    if backend.iteration > settings.max_steps:  # an earlier call had a larger limit
        return _samples(posterior.coordinates, backend, settings)
    latest: Samples | None = None
    for step in _checkpoints(settings):
        if step > backend.iteration:
            state = sampler.run_mcmc(state, step - backend.iteration, skip_initial_state_check=True)
        if latest is None or step == settings.max_steps or _may_be_enough(latest, step, settings):
            latest = _samples(posterior.coordinates, backend, settings, step)
        if on_progress is not None:
            on_progress(_progress(latest, step, settings))
        if latest.is_converged:
            break
    assert latest is not None
    if latest.n_steps < backend.iteration:  # an earlier call had higher targets
        return _samples(posterior.coordinates, backend, settings)
    return latest


def _may_be_enough(latest: Samples, step: int, settings: SamplerSettings) -> bool:
    """Whether targets may be reached, or the diagnostics are old. Computed at every checkpoint, they would cost a quarter of the chain."""
    grown = step / latest.n_steps
    return grown >= OLD_LOOK or grown * latest.convergence.smallest_ess >= LOOK_FROM * settings.target_ess


def _checkpoints(settings: SamplerSettings) -> Iterator[int]:
    """Steps at which to look at the diagnostics, ever further apart; the same whether or not the run was interrupted."""
    step = 0
    while step < settings.max_steps:
        next_step = max(step + settings.check_every, int(1.15 * step))
        step = min(next_step - next_step % settings.check_every, settings.max_steps)
        yield step


def _progress(latest: Samples, step: int, settings: SamplerSettings) -> Progress:
    """Effective samples grow with the steps since the last look at them."""
    ess = latest.convergence.smallest_ess * step / latest.n_steps
    return Progress(step, settings.max_steps, ess, settings.target_ess, latest.convergence.largest_rhat)


def _initial_state(
    log_prob: Callable[[np.ndarray], np.ndarray],
    proposal: MixtureProposal,
    settings: SamplerSettings,
    backend: Backend,
) -> emcee.State:
    """Last sample of a backend that holds steps; otherwise draws of the proposal that lie inside the prior."""
    if backend.iteration > 0:
        return backend.get_last_sample()
    random = np.random.RandomState(settings.seed)
    walkers = np.empty((0, proposal.n + proposal.counts.shape[1]))
    for _ in range(100):
        draws = proposal.draw(settings.n_walkers, random)
        is_inside = np.isfinite(log_prob(draws)) & np.isfinite(proposal.log_density(draws))
        walkers = np.concatenate((walkers, draws[is_inside]))
        if len(walkers) >= settings.n_walkers:
            break
    if not len(walkers):
        raise RuntimeError("no draw of the proposal lies inside the prior")
    walkers = np.resize(walkers, (settings.n_walkers, walkers.shape[1]))
    return emcee.State(walkers, random_state=random.get_state())


def _samples(
    coordinates: Coordinates, backend: Backend, settings: SamplerSettings, n_steps: int | None = None
) -> Samples:
    """The chain and its diagnostics, of the first steps only where their number is given."""
    n_steps = backend.iteration if n_steps is None else n_steps
    burn_in = int(BURN_IN_SHARE * n_steps)
    chain = backend.get_chain()[burn_in:n_steps]
    diagnostics = convergence(reported_parameters(coordinates, chain))
    is_converged = (
        diagnostics.smallest_ess >= settings.target_ess and diagnostics.largest_rhat <= settings.largest_rhat
    )
    return Samples(
        chain,
        backend.get_log_prob()[burn_in:n_steps],
        diagnostics,
        is_converged,
        float(np.mean(backend.accepted / backend.iteration)),
        n_steps,
    )


def reported_parameters(coordinates: Coordinates, chain: np.ndarray) -> np.ndarray:
    """Free parameters, as they are reported, of a chain of coordinates; in the order of `coordinates.names`."""
    values = coordinates.values(torch.from_numpy(chain))
    return np.stack([numpy_of(values[name]) for name in coordinates.names], axis=-1)
