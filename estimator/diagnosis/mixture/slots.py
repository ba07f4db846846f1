"""Samples which items stand beside each other: some slots, each of which holds one item or none (docs/explanation/how-a-cause-is-named.md).

For one slot the evidence of all items beside those in the other slots is known at once, so that it is drawn from its full conditional. The
probability of an item is the mean of its conditional probabilities over all draws.

References:
    George and McCulloch, J. Am. Stat. Assoc. 88, 881 (1993): indicator variables.
    Scott and Berger, Ann. Stat. 38, 2587 (2010): multiplicity. Wang, Sarkar, Carbonetto and Stephens, J. R. Stat. Soc. B 82, 1273 (2020):
    sets of correlated candidates.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.mixture.evidence import Beside, Products

N_NOISES = 46
LEAST_NOISE, MOST_NOISE = 0.05, 1.6  # of that of the fit
MOST_CLIMBS, HIGHER = 3, 1.0  # further ones; the rise in log density that counts
NEGLIGIBLE = 1e-5  # probability of an item beside others below which it is not drawn


@dataclass(frozen=True)
class NoisePrior:
    """What is known of the noise, as a factor on that of the fit.

    Attributes:
        median: Stated noise over the fitted one.
        width: Standard deviation of its logarithm; 0 where it is stated as known.
        p_misstated: Probability that it is another although it is stated as known.
    """

    median: float
    width: float
    p_misstated: float = 0.0

    def grid(self) -> Float[Tensor, " noise"]:
        """Factors that are tried; the stated one first where it is stated as known."""
        is_known = self.width == 0.0
        least, most = (
            (1.0 / policy.MOST_MISSTATED, policy.MOST_MISSTATED) if is_known else (LEAST_NOISE, MOST_NOISE)
        )
        some = torch.logspace(math.log10(least), math.log10(most), N_NOISES, dtype=torch.float64)
        known = torch.ones(1, dtype=torch.float64)
        if not is_known:
            return some
        return torch.cat((known, some)) if self.p_misstated else known

    def log_density(self, noise: Float[Tensor, " noise"]) -> Float[Tensor, " noise"]:
        """Log density of the logarithm, up to a constant."""
        if self.width > 0.0:
            return -0.5 * ((noise.log() - math.log(self.median)) / self.width).square()
        others = max(len(noise) - 1, 1)
        density = torch.full_like(noise, self.p_misstated / others)
        density[0] = 1.0 - self.p_misstated
        return density.log()


class Sweeps(NamedTuple):
    """Draws of all slots, one after another: how many, and how many of the first do not count."""

    n: int
    burn_in: int


@dataclass
class Samples:
    """Which items stood beside each other.

    Attributes:
        n_items: In the dictionary.
        models: How often each set of items was drawn.
        conditional: Sum over draws of the probability of each item beside the others.
        largest: The largest of these probabilities.
        beside: By item that was drawn, the sum of the conditional probabilities of all items of its slot.
        n: Number of draws.
    """

    n_items: int
    models: dict[tuple[int, ...], float] = field(default_factory=lambda: defaultdict(float))
    conditional: np.ndarray = field(init=False)
    largest: np.ndarray = field(init=False)
    beside: dict[int, np.ndarray] = field(default_factory=dict)
    noises: Counter[int] = field(default_factory=Counter)
    n: int = 0

    def __post_init__(self) -> None:
        self.conditional, self.largest = np.zeros(self.n_items), np.zeros(self.n_items)

    def add(self, rest: Sequence[int], probability: np.ndarray, drawn: int | None) -> None:
        """Add one draw of one slot."""
        self.n += 1
        self.conditional += probability
        self.conditional[list(rest)] += 1.0
        np.maximum(self.largest, probability, out=self.largest)
        self.largest[list(rest)] = 1.0
        if drawn is not None:
            if drawn not in self.beside:
                self.beside[drawn] = np.zeros(self.n_items)
            self.beside[drawn] += probability

    def joined(self, others: Sequence[Samples]) -> Samples:
        """These draws and others, which count as much together as these."""
        share = self.n / max(sum(other.n for other in others), 1)
        both = Samples(self.n_items, n=2 * self.n)
        both.conditional = self.conditional + share * sum(other.conditional for other in others)
        for weight, samples in ((1.0, self), *((share, other) for other in others)):
            for model, n in samples.models.items():
                both.models[model] += weight * n
            for drawn, conditional in samples.beside.items():
                both.beside[drawn] = both.beside.get(drawn, 0.0) + weight * conditional
        return both

    def renumbered(self, numbers: Sequence[int], n_items: int) -> Samples:
        """These draws where items have other numbers, among more items."""
        index = np.asarray(numbers, dtype=int)

        def spread(values: np.ndarray) -> np.ndarray:
            among = np.zeros(n_items)
            among[index] = values
            return among

        other = Samples(n_items, n=self.n, noises=self.noises)
        other.conditional, other.largest = spread(self.conditional), spread(self.largest)
        other.beside = {numbers[drawn]: spread(values) for drawn, values in self.beside.items()}
        for model, n in self.models.items():
            other.models[tuple(sorted(numbers[i] for i in model))] += n
        return other

    def one_of(self, items: Sequence[int]) -> float:
        """Probability that one of some items is there that exclude each other."""
        return min(1.0, float(self.present[list(items)].sum()))

    def holding(self, items: Sequence[int]) -> float:
        """Share of the draws that hold at least one of some items."""
        some = set(items)
        total = sum(self.models.values())
        return sum(n for model, n in self.models.items() if some.intersection(model)) / max(total, 1e-300)

    @property
    def present(self) -> np.ndarray:
        """Probability that an item is there."""
        return self.conditional / max(self.n, 1)


class Slots:
    """The sampler at one dictionary.

    Args:
        products: Inner products of its columns.
        noise: What is known of the noise.
        n_slots: Things that may be wrong at once.
        excluded: Items that no slot holds.
    """

    def __init__(
        self,
        products: Products,
        noise: NoisePrior,
        n_slots: int = policy.MOST_CAUSES,
        excluded: Sequence[int] = (),
    ) -> None:
        self.products, self.noise, self.n_slots, self.excluded = products, noise, n_slots, tuple(excluded)
        self.grid = noise.grid()
        self.log_prior_noise = noise.log_density(self.grid)
        items = products.items
        self.log_prior = torch.tensor([item.log_prior for item in items], dtype=torch.float64)
        self.log_prior[list(excluded)] = -math.inf
        names = {name: i for i, name in enumerate(dict.fromkeys(item.name for item in items))}
        self.name = np.array([names[item.name] for item in items], dtype=int)
        self.repeated = np.array([names.get(item.repeated, -1) for item in items], dtype=int)
        self._known: dict[tuple[tuple[int, ...], int], np.ndarray] = {}
        self._densities: dict[tuple[int, ...], Tensor] = {}
        self._last: tuple[tuple[tuple[int, ...], int], Beside] | None = None

    def conditional(self, chosen: Sequence[int], noise: int, without: int | None = None) -> np.ndarray:
        """Probability of each item, and last of none, in one slot beside the items in the others.

        Args:
            chosen: In all other slots, and in this one.
            noise: Number of the factor on the noise.
            without: The item of this slot; None where it is empty.
        """
        rest = tuple(sorted(i for i in chosen if i != without))
        if (rest, noise) not in self._known:
            evidence = self.evidence(chosen, noise, without) + self.log_prior
            both = torch.cat((evidence, evidence.new_tensor([math.log(policy.p_empty())])))
            both[torch.from_numpy(self._cannot_stand_beside(rest))] = -math.inf
            self._known[rest, noise] = torch.softmax(both, 0).numpy()
        return self._known[rest, noise]

    def _cannot_stand_beside(self, rest: Sequence[int]) -> Bool[np.ndarray, " item_or_none"]:
        """Which items, and last none, no slot holds beside others: a second one of a name, or what repeats something that is not there."""
        there, repeated = self.name[list(rest)], self.repeated[list(rest)]
        lacks = (self.repeated >= 0) & ~np.isin(self.repeated, there)
        wanted = np.setdiff1d(repeated[repeated >= 0], there)
        others = ~np.isin(self.name, wanted) if len(wanted) else np.zeros(len(self.name), dtype=bool)
        return np.append(np.isin(self.name, there) | lacks | others, len(wanted) > 0)

    def evidence(
        self, chosen: Sequence[int], noise: int, without: int | None = None
    ) -> Float[Tensor, " item"]:
        """Log Bayes factor of each item beside some that are there, against these alone.

        Args:
            chosen: Numbers of those that are there.
            noise: Number of the factor on the noise.
            without: One of them that is not there.
        """
        key, last = (tuple(sorted(chosen)), noise), self._last
        if (
            last is None or last[0] != key
        ):  # the last ones are remembered, for slots are asked one after another
            before = last[1] if last is not None and last[0][1] == noise else None
            last = self._last = key, Beside(self.products, key[0], float(self.grid[noise]), before=before)
        return last[1].evidence(without)

    def noise_of(self, chosen: Sequence[int]) -> np.ndarray:
        """Probability of each factor on the noise, given the items."""
        return torch.softmax(self._by_noise(chosen), 0).numpy()

    def log_share_of_stated_noise(self, chosen: Sequence[int]) -> float:
        """Log probability that the noise is as stated, given the items; 0 where none is stated as known."""
        return 0.0 if self.noise.width else float(torch.log_softmax(self._by_noise(chosen), 0)[0])

    def _by_noise(self, chosen: Sequence[int]) -> Float[Tensor, " noise"]:
        """Log density of the readings with some items, and of each factor on the noise."""
        key = tuple(sorted(chosen))
        if key not in self._densities:
            self._densities[key] = self.products.log_likelihood(key, self.grid) + self.log_prior_noise
        return self._densities[key]

    def log_density(self, chosen: Sequence[int]) -> float:
        """Log density of the readings and of some items in any slots, the others empty, up to a constant."""
        n, n_empty = self.n_slots, self.n_slots - len(chosen)
        ways = math.lgamma(n + 1) - math.lgamma(n_empty + 1)
        prior = float(self.log_prior[list(chosen)].sum()) + n_empty * math.log(policy.p_empty()) + ways
        return float(torch.logsumexp(self._by_noise(chosen), 0)) + prior

    def climbed(self, begin: Sequence[int] = ()) -> tuple[list[int | None], int]:
        """Slots filled one by one with what is most probable beside the others, and the most probable noise.

        Args:
            begin: Items that the first slots hold at first.
        """
        slots: list[int | None] = [*begin[: self.n_slots], *[None] * max(self.n_slots - len(begin), 0)]
        noise = int(self.noise_of([i for i in slots if i is not None]).argmax())
        for _ in range(self.n_slots):
            before = list(slots)
            for k in range(self.n_slots):
                chosen = [i for i in slots if i is not None]
                best = int(self.conditional(chosen, noise, slots[k]).argmax())
                slots[k] = None if best == len(self.log_prior) else best
            noise = int(self.noise_of([i for i in slots if i is not None]).argmax())
            if slots == before:
                break
        return slots, noise

    def highest(self, begin: Sequence[int] = ()) -> tuple[list[int | None], int]:
        """What a climb leads to, or a climb that does without the strongest item of another, where that leads higher.

        Two departures that together stand for several causes keep these out one by one.

        Args:
            begin: Items where the first climb begins.
        """
        slots, noise = self.climbed(begin)
        for _ in range(MOST_CLIMBS):
            chosen = [i for i in slots if i is not None]
            if len(chosen) < 2:
                break
            gains = self.products.gains(chosen, float(self.grid[noise]))
            strongest = max(gains, key=gains.__getitem__)
            other, _ = self._barring(strongest).climbed()
            other, noise_there = self.climbed([i for i in other if i is not None])
            if self.log_density([i for i in other if i is not None]) < self.log_density(chosen) + HIGHER:
                break
            slots, noise = other, noise_there
        return slots, noise

    def _barring(self, item: int) -> Slots:
        """These slots, which hold nothing of an item's name."""
        without = copy(self)
        without.log_prior = self.log_prior.clone()
        without.log_prior[torch.from_numpy(self.name == self.name[item])] = -math.inf
        without._known = {}
        return without

    def sample(self, sweeps: Sweeps, seed: int, *begin: Sequence[int]) -> Samples:
        """Draw items slot by slot, of those alone that were probable at some point of a climb.

        Args:
            sweeps: Over all slots.
            seed: Of the draws.
            begin: Items where climbs begin, of which the highest counts; without any, one begins with nothing.
        """
        climbs = [self.highest(items) for items in begin or [()]]
        climbed, noise = max(
            climbs, key=lambda climb: self.log_density([i for i in climb[0] if i is not None])
        )
        numbers = self._probable(climbed)
        few = self.among(numbers)
        slots = [None if i is None else numbers.index(i) for i in climbed]
        return few.drawn(sweeps, seed, slots, noise).renumbered(numbers, len(self.log_prior))

    def _probable(self, climbed: Sequence[int | None]) -> list[int]:
        """Items that had more than `NEGLIGIBLE` beside some others, and what repeats such an item."""
        none = np.zeros(len(self.log_prior) + 1)
        largest = np.max([none, *self._known.values()], axis=0)[:-1]
        largest[[i for i in climbed if i is not None]] = 1.0
        is_probable = largest > NEGLIGIBLE
        return np.flatnonzero(is_probable | np.isin(self.repeated, self.name[is_probable])).tolist()

    def among(self, numbers: Sequence[int]) -> Slots:
        """These slots, which can hold some of the items alone."""
        few = Slots(self.products.among(numbers), self.noise, self.n_slots)
        few.log_prior = self.log_prior[numbers]
        return few

    def drawn(self, sweeps: Sweeps, seed: int, begin: Sequence[int | None], noise: int) -> Samples:
        """Draw items slot by slot, of all.

        Args:
            sweeps: Over all slots.
            seed: Of the draws.
            begin: What the slots hold at first.
            noise: Number of the factor on the noise at first.
        """
        random = np.random.default_rng(seed)
        slots, samples = list(begin), Samples(len(self.log_prior))
        for sweep in range(sweeps.n):
            for k in range(self.n_slots):
                rest = [i for j, i in enumerate(slots) if j != k and i is not None]
                probability = self.conditional([i for i in slots if i is not None], noise, slots[k])
                drawn = int(np.searchsorted(np.cumsum(probability), random.random() * probability.sum()))
                slots[k] = drawn if drawn < len(self.log_prior) else None
                if sweep >= sweeps.burn_in:
                    samples.add(rest, probability[:-1], slots[k])
            chosen = [i for i in slots if i is not None]
            of_noise = self.noise_of(chosen)
            noise = int(np.searchsorted(np.cumsum(of_noise), random.random() * of_noise.sum()))
            noise = min(noise, len(self.grid) - 1)
            if sweep >= sweeps.burn_in:
                samples.models[tuple(sorted(chosen))] += 1
                samples.noises[noise] += 1
        return samples
