"""Posterior sampling with emcee: all walkers in one batched call, checkpoints, and a stop that the samples decide."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import emcee
import numpy as np
import torch
from emcee.backends import Backend

from estimator.errors import InvalidInput
from estimator.inference.convergence import Convergence, convergence
from estimator.inference.lattice import CountMixture
from estimator.inference.likelihood import LogPosterior
from estimator.inference.moves import (
    LatticeDifferenceMove,
    MixtureProposal,
    autoregressive_move,
    independence_move,
)
from estimator.rig.coordinates import Coordinates

INDEPENDENCE_SHARE, AUTOREGRESSIVE_SHARE = 0.7, 0.15  # the rest is differential evolution
BURN_IN_SHARE = 0.1
FEWEST_WALKERS = 32


@dataclass(frozen=True)
class SamplerSettings:
    """How long to sample.

    Attributes:
        n_walkers: Walkers in the ensemble; 0 stands for 32, or two per free parameter where that is more. Many short chains need more
            samples before R-hat believes them.
        target_ess: Wanted effective sample size (bulk and tail) of every coordinate.
        largest_rhat: R-hat that every coordinate must fall below.
        max_steps: Give up here and say so.
        check_every: Steps between looks at the diagnostics, and between checkpoints.
        seed: Of the random state; the same seed gives the same chain on the same machine.
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
        """The same settings with a number of walkers that suits the moves: two per dimension, and two more than dimensions.

        Raises:
            InvalidInput: Too few were asked for.
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
    """One look at a running chain."""

    step: int
    max_steps: int
    smallest_ess: float
    target_ess: float
    largest_rhat: float


@dataclass(frozen=True)
class Samples:
    """The chain after burn-in with its diagnostics.

    Attributes:
        chain: Step by walker by coordinate.
        log_prob: Step by walker.
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
    posterior: LogPosterior,
    mixture: CountMixture,
    settings: SamplerSettings,
    backend: Backend | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> Samples:
    """Sample the posterior until the effective sample size and R-hat say that it is enough.

    Walkers start from draws of the Laplace mixture; the first tenth of the steps is dropped. A backend that already holds steps is
    continued.

    Args:
        posterior: Density over coordinates with whole-numbered counts in the last columns.
        mixture: Laplace mixture, the proposal of the independence move.
        settings: When to stop.
        backend: emcee backend; in memory by default.
        on_progress: Called after every look at the diagnostics.
    Returns: The chain; `is_converged` is False where `max_steps` came first.
    Raises:
        InvalidInput: Too few walkers for the number of coordinates.
    References: Foreman-Mackey et al., PASP 125, 306 (2013).
    """

    def log_prob(vectors: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return posterior(torch.from_numpy(vectors)).numpy()

    proposal = MixtureProposal(mixture)
    moves = [
        (independence_move(proposal), INDEPENDENCE_SHARE),
        (autoregressive_move(proposal), AUTOREGRESSIVE_SHARE),
        (LatticeDifferenceMove(proposal), 1.0 - INDEPENDENCE_SHARE - AUTOREGRESSIVE_SHARE),
    ]
    backend = backend if backend is not None else Backend()
    n = posterior.coordinates.n
    settings = settings.for_rig(n)
    sampler = emcee.EnsembleSampler(
        settings.n_walkers, n, log_prob, moves=moves, vectorize=True, backend=backend
    )
    if backend.iteration > 0:
        state = backend.get_last_sample()
    else:
        random = np.random.RandomState(settings.seed)
        state = emcee.State(
            _start(log_prob, proposal, settings.n_walkers, random), random_state=random.get_state()
        )
    if backend.iteration > settings.max_steps:  # a longer run was asked for before
        return _look(posterior.coordinates, backend, settings)
    for step in _look_steps(settings):
        if step < backend.iteration:
            continue
        if step > backend.iteration:
            state = sampler.run_mcmc(state, step - backend.iteration, skip_initial_state_check=True)
        result = _look(posterior.coordinates, backend, settings)
        if on_progress is not None:
            on_progress(_progress(result, settings))
        if result.is_converged:
            break
    return result


def _look_steps(settings: SamplerSettings) -> Iterator[int]:
    """Steps at which to look, ever further apart; the same whether or not the run was interrupted."""
    step = 0
    while step < settings.max_steps:
        ahead = max(step + settings.check_every, int(1.15 * step))
        step = min(ahead - ahead % settings.check_every, settings.max_steps)
        yield step


def _progress(result: Samples, settings: SamplerSettings) -> Progress:
    ess, rhat = result.convergence.smallest_ess, result.convergence.largest_rhat
    return Progress(result.n_steps, settings.max_steps, ess, settings.target_ess, rhat)


def _start(
    log_prob: Callable[[np.ndarray], np.ndarray],
    proposal: MixtureProposal,
    size: int,
    random: np.random.RandomState,
) -> np.ndarray:
    """Draws of the mixture that lie inside the prior."""
    found = np.empty((0, proposal.n + proposal.counts.shape[1]))
    for _ in range(100):
        draws = proposal.draw(size, random)
        found = np.concatenate((found, draws[np.isfinite(log_prob(draws))]))
        if len(found) >= size:
            break
    if not len(found):
        raise RuntimeError("no draw of the Laplace mixture lies inside the prior")
    return np.resize(found, (size, found.shape[1]))


def _look(coordinates: Coordinates, backend: Backend, settings: SamplerSettings) -> Samples:
    burn_in = int(BURN_IN_SHARE * backend.iteration)
    chain = backend.get_chain(discard=burn_in)
    diagnostics = convergence(reported(coordinates, chain))
    enough = (
        diagnostics.smallest_ess >= settings.target_ess and diagnostics.largest_rhat <= settings.largest_rhat
    )
    return Samples(
        chain,
        backend.get_log_prob(discard=burn_in),
        diagnostics,
        enough,
        float(np.mean(backend.accepted / backend.iteration)),
        backend.iteration,
    )


def reported(coordinates: Coordinates, chain: np.ndarray) -> np.ndarray:
    """A chain of coordinates as the free parameters that are reported, in the order of `coordinates.names`."""
    values = coordinates.values(torch.from_numpy(chain))
    return np.stack([values[name].numpy() for name in coordinates.names], axis=-1)
