"""Places of multipoles beside a box of charges, found one after another by the evidence of readings.

Each multipole begins at the best place of a grid outside the box and moves to where the evidence is largest, all amplitudes integrated out;
then all move once more, each beside the others. One that the box comes much nearer to than any reading is left to the charges: where the
box is nearest its field would be a guess.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from estimator.inference.nelder_mead import initial_simplex, minimise
from estimator.rig.bodies import EquivalentSourceCoil
from estimator.rig.charged_box import Triple, gap_m

LEAST_GAIN = 20.0  # in log evidence, of each multipole: a source that is there gains hundreds
LEAST_RESOLVED = 0.7  # distance from the box over that from the nearest reading: below, places in the box are much nearer than any reading
LEAST_GAIN_ON_GRID = 5.0  # before it moves
MOST_MULTIPOLES = 8
# Distances from the box, over the margin; from the margin on charges can stand for the source.
NEAREST, FARTHEST = 0.1, 2.0
GRID_GAPS = (0.2, 0.5)  # distances of the grid's layers, over the margin; its places are twice as far apart
MOST_ITERATIONS = 50
PLACED_TO = 1e-3  # of the margin
TRIED_NOISE = 10.0 ** np.arange(-8.0, 0.0, 0.2)  # over the rms of the readings
N_FINER = 4  # noises below the last that are tried while a place moves

# Components of readings by prior standard deviation of each amplitude of a multipole at a place.
Columns = Callable[[Triple], np.ndarray]


class Found(NamedTuple):
    """What a search found.

    Attributes:
        places_m: In the order in which they were found.
        gains: Rise of the log evidence with each.
    """

    places_m: tuple[Triple, ...]
    gains: tuple[float, ...]


class _Part(NamedTuple):
    """Columns by what the charges can make of them: along the combinations of readings that charges move, and the rest."""

    along: np.ndarray
    rest: np.ndarray

    def beside(self, other: _Part) -> _Part:
        return _Part(np.hstack((self.along, other.along)), np.hstack((self.rest, other.rest)))


@dataclass
class PlaceSearch:
    """A box of charges whose readings may ask for multipoles beside it.

    Attributes:
        coil: With the charges.
        seen_m: Places of the readings in the frame of the coil, of those with current in it.
        charges_T: Components of the readings, one below the other, by prior standard deviation of each amplitude.
        columns: The same of a multipole at a place in the frame of the coil; zeros where none may be.
    """

    coil: EquivalentSourceCoil
    seen_m: np.ndarray
    charges_T: np.ndarray
    columns: Columns

    def __post_init__(self) -> None:
        self._left, self._size, _ = np.linalg.svd(self.charges_T, full_matrices=False)
        self._grid_m = _grid_m(self.coil)
        stacked = np.stack([self.columns(place_m) for place_m in self._grid_m], 1)
        flat = self._part(stacked.reshape(len(stacked), -1))
        self._candidates = _Part(*(part.reshape(len(part), *stacked.shape[1:]) for part in flat))

    def find(self, measured_T: np.ndarray) -> Found:
        """Multipoles that readings ask for, one after another while each has clear evidence, but for those that are not resolved.

        Args:
            measured_T: Components of the readings, less what the rig predicts without its amplitudes.
        """
        return self.resolved(self.find_any(measured_T))

    def find_any(self, measured_T: np.ndarray) -> Found:
        """Multipoles that readings ask for, resolved or not.

        Those that are not resolved take part so that no other is drawn to their sources.
        """
        measured, ladder_T = self._part(measured_T[:, None]), _ladder_T(measured_T)
        places: list[Triple] = []
        gains: list[float] = []
        before, noise_T = self._best(measured, [], ladder_T)
        while len(places) < MOST_MULTIPOLES:
            place_m, gain = self._likeliest(measured, places, noise_T)
            if gain < LEAST_GAIN_ON_GRID:
                break
            trial = self._moved(measured, [*places, place_m], len(places), self._finer(ladder_T, noise_T))
            after, finer_T = self._best(measured, trial, ladder_T)
            if after - before < LEAST_GAIN:
                break
            if places:  # the others were placed without it; what they still miss would draw the next one
                trial = self._each_moved(measured, trial, self._finer(ladder_T, finer_T))
                after, finer_T = self._best(measured, trial, ladder_T)
            gains.append(after - before)
            places, before, noise_T = trial, after, finer_T
        return Found(tuple(places), tuple(gains))

    def resolved(self, multipoles: Found) -> Found:
        """Multipoles that are resolved, of those that a search found: readings are about as near to their places as the box is."""
        indices = [i for i, place_m in enumerate(multipoles.places_m) if self._is_resolved(place_m)]
        return Found(
            tuple(multipoles.places_m[i] for i in indices), tuple(multipoles.gains[i] for i in indices)
        )

    def log_evidence(self, measured_T: np.ndarray, places_m: Sequence[Triple]) -> float:
        """Log evidence of the readings with multipoles at places, up to a constant, at the noise that makes it largest."""
        return self._best(self._part(measured_T[:, None]), list(places_m), _ladder_T(measured_T))[0]

    def moved(self, measured_T: np.ndarray, places_m: Sequence[Triple]) -> tuple[Triple, ...]:
        """The places, each moved once to where the evidence is largest beside the others."""
        measured, ladder_T = self._part(measured_T[:, None]), _ladder_T(measured_T)
        _, noise_T = self._best(measured, list(places_m), ladder_T)
        return tuple(self._each_moved(measured, list(places_m), self._finer(ladder_T, noise_T)))

    def _is_resolved(self, place_m: Triple) -> bool:
        """Whether readings are about as near to a place as the box is."""
        nearest_m = np.linalg.norm(self.seen_m - np.array(place_m), axis=1).min()
        return gap_m(place_m, self.coil.half_m) >= LEAST_RESOLVED * float(nearest_m)

    def _finer(self, ladder_T: np.ndarray, noise_T: float) -> np.ndarray:
        """Noises of the ladder in T: a given one and a few below it."""
        return ladder_T[ladder_T <= 1.01 * noise_T][-N_FINER - 1 :]

    def _best(self, measured: _Part, places: list[Triple], noises_T: np.ndarray) -> tuple[float, float]:
        """Largest log evidence, up to a constant, and the noise that has it."""
        joined = self._joined(places)
        each = [self._log_evidence(measured, joined, noise_T) for noise_T in noises_T]
        return max(each), float(noises_T[int(np.argmax(each))])

    def _each_moved(self, measured: _Part, places: list[Triple], noises_T: np.ndarray) -> list[Triple]:
        """The places, each moved once beside the others."""
        for i in range(len(places)):
            places = self._moved(measured, places, i, noises_T)
        return places

    def _moved(self, measured: _Part, places: list[Triple], i: int, noises_T: np.ndarray) -> list[Triple]:
        """The places with one of them moved to where the evidence is largest."""
        others = self._joined([place for j, place in enumerate(places) if j != i])

        def loss(rows: torch.Tensor) -> torch.Tensor:
            return rows.new_tensor(
                [self._loss(measured, others, tuple(row), noises_T) for row in rows.tolist()]
            )

        start = torch.tensor([places[i]], dtype=torch.float64)
        step = torch.full((3,), 0.1 * self.coil.margin_m, dtype=torch.float64)
        result = minimise(
            loss,
            initial_simplex(start, step),
            x_tolerance=PLACED_TO * self.coil.margin_m,
            f_tolerance=1.0,
            max_iterations=MOST_ITERATIONS,
        )
        x_m, y_m, z_m = result.points[0].tolist()
        return [*places[:i], (x_m, y_m, z_m), *places[i + 1 :]]

    def _loss(self, measured: _Part, others: _Part, place_m: Triple, noises_T: np.ndarray) -> float:
        if not NEAREST <= gap_m(place_m, self.coil.half_m) / self.coil.margin_m <= FARTHEST:
            return np.inf
        with_it = others.beside(self._part(self.columns(place_m)))
        best: float = max(self._log_evidence(measured, with_it, noise_T) for noise_T in noises_T)
        return -best

    def _likeliest(self, measured: _Part, places: list[Triple], noise_T: float) -> tuple[Triple, float]:
        """Place of the grid where one more multipole raises the evidence most, and by how much at the same noise."""
        known, new = self._joined(places), self._candidates
        inner, cross = self._inner(known, known, noise_T), self._inner(known, measured, noise_T)
        weight = np.linalg.inv(np.eye(len(inner)) + inner)
        per_variance = 1.0 / (self._size**2 + noise_T**2)
        weighted = new.along * per_variance[:, None, None]
        own = np.einsum("nqc,nqd->qcd", new.along, weighted, optimize=True)
        own += np.einsum("nqc,nqd->qcd", new.rest, new.rest, optimize=True) / noise_T**2
        to_known = np.einsum("nqc,na->qca", weighted, known.along, optimize=True)
        to_known += np.einsum("nqc,na->qca", new.rest, known.rest, optimize=True) / noise_T**2
        to_measured = np.einsum("nqc,nm->qcm", weighted, measured.along, optimize=True)
        to_measured += np.einsum("nqc,nm->qcm", new.rest, measured.rest, optimize=True) / noise_T**2
        precision = np.eye(own.shape[-1]) + own - to_known @ weight @ to_known.transpose(0, 2, 1)
        score = to_measured - to_known @ (weight @ cross)
        fit = (score * np.linalg.solve(precision, score)).sum((1, 2))
        gain = 0.5 * (fit - np.linalg.slogdet(precision)[1])
        return self._grid_m[int(gain.argmax())], float(gain.max())

    def _log_evidence(self, measured: _Part, multipoles: _Part, noise_T: float) -> float:
        """Log evidence of the readings at one noise, up to a constant, with all amplitudes integrated out."""
        n = len(measured.rest) - len(self._size)
        log_determinant = np.log(self._size**2 + noise_T**2).sum() + 2.0 * n * np.log(noise_T)
        total = float(self._inner(measured, measured, noise_T)[0, 0]) + log_determinant
        precision = self._inner(multipoles, multipoles, noise_T)
        precision += np.eye(len(precision))
        score = self._inner(multipoles, measured, noise_T)
        fit = float((score * np.linalg.solve(precision, score)).sum())
        return 0.5 * (fit - float(total) - float(np.linalg.slogdet(precision)[1]))

    def _inner(self, first: _Part, other: _Part, noise_T: float) -> np.ndarray:
        """Inner products of columns over the covariance of noise and charges."""
        per_variance = 1.0 / (self._size**2 + noise_T**2)
        return first.along.T @ (per_variance[:, None] * other.along) + first.rest.T @ other.rest / noise_T**2

    def _part(self, columns: np.ndarray) -> _Part:
        along = self._left.T @ columns
        return _Part(along, columns - self._left @ along)

    def _joined(self, places: list[Triple]) -> _Part:
        joined = _Part(np.zeros((len(self._size), 0)), np.zeros((len(self.charges_T), 0)))
        for place_m in places:
            joined = joined.beside(self._part(self.columns(place_m)))
        return joined


def _ladder_T(measured_T: np.ndarray) -> np.ndarray:
    return TRIED_NOISE * np.sqrt(np.mean(measured_T**2))


def _grid_m(coil: EquivalentSourceCoil) -> list[Triple]:
    """Places outside the box in layers, the nearer the denser."""
    places: list[Triple] = []
    for share in GRID_GAPS:
        layer_m = share * coil.margin_m
        reach_m = [half_m + layer_m for half_m in coil.half_m]
        axes = [np.linspace(-r, r, 1 + max(1, round(r / layer_m))) for r in reach_m]
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        on_surface = (np.abs(grid) >= np.array(reach_m) * (1.0 - 1e-9)).any(-1)
        places += [(x, y, z) for x, y, z in grid[on_surface].tolist()]
    return places
