"""Places of multipoles beside a box of charges, found one after another by the evidence of readings.

Charges on a box stand for sources no nearer to it than they are themselves. A small source that is nearer shows at a few places only, and
the noise takes up what the charges miss there. Each multipole begins at the best place of a grid outside the box and moves to where the
evidence is largest, all amplitudes integrated out; then all move once more, each beside the others. One that the box comes much nearer to
than any reading is left to the charges: where the box is nearest its field would be a guess. A place is then held as known, so intervals
right beside it are too narrow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import torch

from estimator.errors import InvalidInput
from estimator.inference.collapsed import CollapsedPosterior
from estimator.inference.likelihood import LogPosterior
from estimator.inference.nelder_mead import initial_simplex, minimise
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.bodies import AnyCoil, EquivalentSourceCoil
from estimator.rig.charged_box import Triple, gap_m
from estimator.rig.coordinates import Coordinates
from estimator.rig.parameters import Normal, Parameter
from estimator.rig.rig import Rig

LEAST_GAIN = 20.0  # in log evidence, of each multipole: a source that is there gains hundreds
LEAST_RESOLVED = 0.7  # distance from the box over that from the nearest reading: below, places in the box are much nearer than any reading
LEAST_GAIN_ON_GRID = 5.0  # before it moves
MOST_MULTIPOLES = 8
# Distances from the box, over the margin; from the margin on charges can stand for the source.
NEAREST, FARTHEST = 0.1, 2.0
GRID_GAPS = (0.2, 0.5)  # distances of the grid's layers, over the margin; its places are twice as far apart
MOST_ITERATIONS = 50
SPARSE_M = 1e3  # leaves charges at corners only, where none is needed
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


def with_multipoles(rig: Rig, observations: Observations) -> tuple[Rig, Found]:
    """The rig with multipoles beside its box of charges where readings ask for them, and what was found.

    Args:
        rig: With a single coil without a winding, whose charges all have one prior; beside these only the noise of one sensor is free.
        observations: Those for validation are not looked at.
    Raises: InvalidInput: The rig is another.
    """
    seen = observations.calibration
    posterior = CollapsedPosterior(LogPosterior(Coordinates(rig), MeasurementModel.build(rig, seen), seen))
    coil, prior = _searchable(rig, posterior.coordinates.names)
    charges_T, measured_T = posterior.at_start
    model = posterior.full.model
    is_on = seen.current_A[:, rig.coils.index(coil)] != 0.0
    seen_m = model.readings_in_coil(coil, model.nominal)[0][is_on]

    sparse = replace(coil, spacing_m=SPARSE_M)
    silent = {name: Parameter(name, "T/A", 0.0) for name in sparse.amplitudes[1]}
    others = {name: p for name, p in rig.parameters.items() if name not in coil.amplitudes[1]}
    bare = replace(rig, coils=_replaced(rig, sparse), parameters={**others, **silent})

    def columns(place_m: Triple) -> np.ndarray:
        multipole_rig = _placed(bare, (place_m,), prior)
        with_one = MeasurementModel.unruled(multipole_rig, seen).with_rules(model.rules)
        own = CollapsedPosterior(LogPosterior(Coordinates(multipole_rig), with_one, seen))
        return own.at_start[0].numpy()

    multipoles = PlaceSearch(coil, seen_m.numpy(), charges_T.numpy(), columns).find(measured_T.numpy())
    return _placed(rig, (*coil.multipoles_m, *multipoles.places_m), prior), multipoles


def _searchable(rig: Rig, others: tuple[str, ...]) -> tuple[EquivalentSourceCoil, Normal]:
    """The coil of a rig that can be searched, and the prior of its amplitudes."""
    what = "a rig whose multipoles are searched"
    boxes = [coil for coil in rig.unwound if isinstance(coil, EquivalentSourceCoil) and not coil.multipoles_m]
    if len(boxes) != 1 or len(rig.unwound) != 1:
        names = ", ".join(coil.name for coil in rig.unwound) or "none"
        raise InvalidInput(
            f"{what} must have one coil without a winding, with charges on a box and no multipoles yet; received {names} ({rig.name})"
        )
    (coil,) = boxes
    priors = {rig.parameters[name].prior for name in coil.amplitudes[1]}
    (prior, *more) = priors
    if more or not isinstance(prior, Normal) or prior.mean != 0.0:
        raise InvalidInput(
            f"{what} must give all charges of {coil.name} one normal prior about 0; received others ({rig.name})"
        )
    if len(rig.sensors) != 1 or not set(others) <= {f"{rig.sensors[0].name}.noise_T"}:
        raise InvalidInput(
            f"{what} must leave nothing free but amplitudes and the noise of one sensor; received {', '.join(others)} ({rig.name})"
        )
    return coil, prior


def _replaced(rig: Rig, own: EquivalentSourceCoil) -> tuple[AnyCoil, ...]:
    return tuple(own if coil.name == own.name else coil for coil in rig.coils)


def _placed(rig: Rig, places_m: tuple[Triple, ...], prior: Normal) -> Rig:
    """The rig with multipoles at places, whose amplitudes have the prior of the charges."""
    (coil,) = rig.unwound
    assert isinstance(coil, EquivalentSourceCoil)
    own = replace(coil, multipoles_m=places_m)
    named = {
        name: rig.parameters.get(name) or Parameter(name, "T/A", 0.0, prior) for name in own.amplitudes[1]
    }
    return replace(rig, coils=_replaced(rig, own), parameters={**rig.parameters, **named})


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
        finer_T: np.ndarray = ladder_T[ladder_T <= 1.01 * noise_T][-N_FINER - 1 :]
        return finer_T

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
        product: np.ndarray = (
            first.along.T @ (per_variance[:, None] * other.along) + first.rest.T @ other.rest / noise_T**2
        )
        return product

    def _part(self, columns: np.ndarray) -> _Part:
        along = self._left.T @ columns
        return _Part(along, columns - self._left @ along)

    def _joined(self, places: list[Triple]) -> _Part:
        joined = _Part(np.zeros((len(self._size), 0)), np.zeros((len(self.charges_T), 0)))
        for place_m in places:
            joined = joined.beside(self._part(self.columns(place_m)))
        return joined


def _ladder_T(measured_T: np.ndarray) -> np.ndarray:
    ladder_T: np.ndarray = TRIED_NOISE * np.sqrt(np.mean(measured_T**2))
    return ladder_T


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
