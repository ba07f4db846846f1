"""Multipoles beside a box of charges, at places found by evidence: magnets near a cube of 10 mm, or maps of eight coils.

Judged on places held out, in blocks of neighbours, which neither the search nor the fit sees. Every magnet is judged without and with a
small one right beside the cube. `--maps` needs the folder named by COILCAL_DATA; seeds are of folds then.

With `--places-from-all` the places come from all readings, in hindsight, and the amplitudes from those of the fit: no choice of places by
fewer readings is expected to do better. The evidence of the readings of each fit then says whether they would have told these places from
those that were found without hindsight. If they have more evidence for the latter, no search by evidence could have found the former.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import magpylib
import numpy as np
import torch

from estimator.calibration.place_search import Found, PlaceSearch
from estimator.model.coil_field import unwound_field
from estimator.rig.bodies import EquivalentSourceCoil
from estimator.rig.charged_box import Triple
from estimator.rig.rig import Rig
from scripts.studies.charges_on_a_box import (
    NOISE_T,
    RMS_T,
    Z90,
    beside,
    columns,
    maps,
    most_probable_noise,
    session_at,
)
from scripts.studies.harmonic_coils import BOX, N_FOLDS, N_WORST, eight_coils, folds, one_coil

SD_T = 1e-3  # of the prior of an amplitude


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[150061, 150062])
    parser.add_argument("--maps", action="store_true")
    parser.add_argument("--only", nargs="+", help="coils")
    parser.add_argument(
        "--places-from-all", action="store_true", help="places of multipoles by all readings, in hindsight"
    )
    parser.add_argument("--folds", type=int, nargs="+", default=list(range(N_FOLDS)))
    options = parser.parse_args()
    torch.set_num_threads(1)
    rig = one_coil(eight_coils(None, BOX), "c1")
    axis_m = 1e-3 * torch.arange(-5.0, 6.0, dtype=torch.float64)
    places_m = torch.cartesian_prod(axis_m, axis_m, axis_m)
    if options.maps:
        session, (fields_T,), names = maps()
        places_m = session.observations.motion["stage"][:, :3]
        fold = {seed: folds(session, seed).numpy() for seed in options.seeds}
    else:
        fields_T = np.concatenate([by_magnets(seed, places_m.numpy()) for seed in options.seeds])
        names = [f"{seed} {what}" for seed in options.seeds for what in ("far", "one beside")]
        fold = {options.seeds[0]: folds(session_at(rig, places_m), options.seeds[0]).numpy()}
    design = columns(rig, places_m)
    wanted = [i for i, name in enumerate(names) if not options.only or name in options.only]
    if options.places_from_all:
        for i in wanted:
            Hindsight(rig, places_m, design, names[i], fields_T[i]).judge(fold, options.folds)
        return
    for seed, own in fold.items():
        print(f"folds of seed {seed}")
        found = [Judged(len(places_m)) for _ in names]
        for number in options.folds:
            judge(rig, places_m, design, fields_T, own, number, found, wanted)
        for i in wanted:
            found[i].show(names[i], fields_T[i])


class Errors:
    """Squared errors of one field and shares of components in their intervals, by place."""

    def __init__(self, n: int) -> None:
        self.square, self.held = np.full(n, np.nan), np.full(n, np.nan)

    def text(self, field_T: np.ndarray) -> str:
        """Error over the rms field with all places and without the worst, the largest, and coverage."""
        seen = ~np.isnan(self.square)
        share = np.sort(self.square[seen]) / (field_T**2).sum(1).mean()
        return (
            f"error {share.mean() ** 0.5:.4%}, largest {share[-1] ** 0.5:.2%}, without the worst {N_WORST} "
            f"{share[:-N_WORST].mean() ** 0.5:.4%}, coverage {self.held[seen].mean():.1%}"
        )


class Judged:
    """One field, fold by fold, by charges alone and with multipoles beside them."""

    def __init__(self, n: int) -> None:
        self.alone, self.beside = Errors(n), Errors(n)
        self.places_m: list[tuple[Triple, ...]] = []

    def show(self, name: str, field_T: np.ndarray) -> None:
        """Both in one line each."""
        print(f"  {name}, charges alone: {self.alone.text(field_T)}")
        counts = [len(places) for places in self.places_m]
        print(f"  {name}, with multipoles: {self.beside.text(field_T)}, multipoles {counts}", flush=True)


def judge(
    rig: Rig,
    places_m: torch.Tensor,
    design: np.ndarray,
    fields_T: np.ndarray,
    fold: np.ndarray,
    number: int,
    found: list[Judged],
    wanted: list[int],
) -> None:
    """One fold: multipoles from what is seen, then the fit, then errors and intervals of what is not."""
    coil = rig.unwound[0]
    assert isinstance(coil, EquivalentSourceCoil)
    is_seen = fold != number
    search = search_of(coil, places_m, design, is_seen)
    without = np.linalg.svd(search.charges_T, full_matrices=False)
    for i in wanted:
        places, gains = search.find(fields_T[i][is_seen].ravel())
        alone = predicted(design, fields_T[i], is_seen, without)
        extra = [by_multipole(coil, place_m, places_m) for place_m in places]
        with_them = np.concatenate((design, *extra), 2)
        square, held = predicted(with_them, fields_T[i], is_seen, None) if extra else alone
        found[i].alone.square[~is_seen], found[i].alone.held[~is_seen] = alone
        found[i].beside.square[~is_seen], found[i].beside.held[~is_seen] = square, held
        found[i].places_m.append(places)
        rms_T = (fields_T[i] ** 2).sum(1).mean() ** 0.5
        worst = square.max() ** 0.5 / rms_T
        worst_mm = (1e3 * places_m[torch.from_numpy(~is_seen)][int(square.argmax())]).round().int().tolist()
        each = [f"{in_mm((place_m,))} {gain:+.0f}" for place_m, gain in zip(places, gains, strict=True)]
        print(
            f"    fold {number} field {i + 1}: charges alone {alone[0].mean() ** 0.5 / rms_T:.4%}, "
            f"{square.mean() ** 0.5 / rms_T:.4%}, largest {worst:.2%} at {worst_mm}, "
            f"held {held[square.argmax()]:.0%}; {'; '.join(each) or 'no multipole'}",
            flush=True,
        )


class Hindsight:
    """One field, with multipoles at places that all of its readings ask for."""

    def __init__(
        self, rig: Rig, places_m: torch.Tensor, design: np.ndarray, name: str, field_T: np.ndarray
    ) -> None:
        coil = rig.unwound[0]
        assert isinstance(coil, EquivalentSourceCoil)
        self.coil, self.places_m, self.design, self.name, self.field_T = coil, places_m, design, name, field_T
        self.rms_T = float((field_T**2).sum(1).mean() ** 0.5)
        everywhere = np.ones(len(places_m), dtype=bool)
        search = search_of(coil, places_m, design, everywhere)
        self.any = search.find_any(field_T.ravel()).places_m
        self.resolved = search.resolved(Found(self.any, (0.0,) * len(self.any))).places_m
        print(f"{name}, places by all readings: {in_mm(self.any)}; {len(self.resolved)} of them resolved")
        for words, places in (("all of them", self.any), ("those resolved", self.resolved)):
            error = self.error(places, everywhere, everywhere)
            print(f"  {words}, fitted to all readings, none held out: {error:.4%}", flush=True)

    def error(self, places: tuple[Triple, ...], is_seen: np.ndarray, is_asked: np.ndarray) -> float:
        """Rms error over the rms field at places that are asked, with amplitudes by what is seen."""
        square = self.squares(places, is_seen, is_asked)
        return float(square.mean() ** 0.5 / self.rms_T)

    def squares(self, places: tuple[Triple, ...], is_seen: np.ndarray, is_asked: np.ndarray) -> np.ndarray:
        """Squared errors by place."""
        extra = [by_multipole(self.coil, place_m, self.places_m) for place_m in places]
        square, _ = predicted(np.concatenate((self.design, *extra), 2), self.field_T, is_seen, None, is_asked)
        return square

    def judge(self, fold_by_seed: dict[int, np.ndarray], folds: list[int]) -> None:
        """Every fold of every seed: errors with each choice of places, and their evidence by what is seen."""
        for seed, fold in fold_by_seed.items():
            squares: dict[str, list[np.ndarray]] = {}
            for number in folds:
                is_seen = fold != number
                measured_T = self.field_T[is_seen].ravel()
                search = search_of(self.coil, self.places_m, self.design, is_seen)
                found = search.find_any(measured_T)
                choices = {
                    "charges alone": (),
                    "found without": search.resolved(found).places_m,
                    "found without, also unresolved": found.places_m,
                    "from all, resolved": self.resolved,
                    "from all": self.any,
                    "from all, then moved without": search.moved(measured_T, self.any),
                }
                alone = search.log_evidence(measured_T, ())
                told = []
                for words, places in choices.items():
                    square = self.squares(places, is_seen, ~is_seen)
                    squares.setdefault(words, []).append(square)
                    gain = search.log_evidence(measured_T, places) - alone
                    error = square.mean() ** 0.5 / self.rms_T
                    told.append(f"{words} ({len(places)}) {error:.4%}, {gain:+.0f}")
                print(f"  {self.name}, seed {seed}, fold {number}: {'; '.join(told)}", flush=True)
            for words, by_fold in squares.items():
                share = np.sort(np.concatenate(by_fold)) / self.rms_T**2
                print(
                    f"  {self.name}, seed {seed}, {words}: error {share.mean() ** 0.5:.4%}, largest {share[-1] ** 0.5:.2%}, "
                    f"without the worst {N_WORST} {share[:-N_WORST].mean() ** 0.5:.4%}",
                    flush=True,
                )


def search_of(
    coil: EquivalentSourceCoil, places_m: torch.Tensor, design: np.ndarray, is_seen: np.ndarray
) -> PlaceSearch:
    """The search for multipoles by what is seen."""

    def of_multipole(place_m: Triple) -> np.ndarray:
        return by_multipole(coil, place_m, places_m)[is_seen].reshape(-1, 8)

    charges_T = design[is_seen].reshape(-1, design.shape[-1])
    return PlaceSearch(coil, places_m.numpy()[is_seen], charges_T, of_multipole)


def in_mm(places_m: tuple[Triple, ...]) -> str:
    return ", ".join(f"({x * 1e3:.2f}, {y * 1e3:.2f}, {z * 1e3:.2f}) mm" for x, y, z in places_m) or "none"


def by_multipole(coil: EquivalentSourceCoil, place_m: Triple, places_m: torch.Tensor) -> np.ndarray:
    """Components of the field at places, by prior standard deviations of the amplitudes of one multipole."""
    alone = replace(coil, spacing_m=1.0, multipoles_m=(place_m,))
    (names,) = alone.amplitudes.values()
    own = torch.eye(len(names), dtype=torch.float64)[alone.n_charges :] * SD_T
    field_T = unwound_field(alone, dict(zip(names, own.T, strict=True))).by(None)(places_m)
    return field_T.permute(1, 2, 0).numpy()


def predicted(
    design: np.ndarray,
    field_T: np.ndarray,
    is_seen: np.ndarray,
    parts: tuple[np.ndarray, np.ndarray, np.ndarray] | None,
    is_asked: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Squared error of each place that is asked, by default of those held out, and the share of its components in their intervals."""
    is_asked = ~is_seen if is_asked is None else is_asked
    seen, unseen = (design[of].reshape(-1, design.shape[-1]) for of in (is_seen, is_asked))
    left, size, right = parts or np.linalg.svd(seen, full_matrices=False)
    noise_T, projected_T = most_probable_noise(size, left, field_T[is_seen].ravel())
    along = unseen @ right.T
    beside_all = np.clip((unseen**2).sum(1) - (along**2).sum(1), 0.0, None)
    shrunk = size**2 + noise_T**2
    error_T = along @ (size * projected_T / shrunk) - field_T[is_asked].ravel()
    variance = along**2 @ (noise_T**2 / shrunk) + beside_all + noise_T**2
    is_held = np.abs(error_T) < Z90 * np.sqrt(variance)
    return (error_T**2).reshape(-1, 3).sum(1), is_held.reshape(-1, 3).mean(1)


def by_magnets(seed: int, places_m: np.ndarray) -> np.ndarray:
    """Fields of three magnets 6 to 20 mm off the cube, without and with a small one 0.4 to 2 mm off that makes a tenth of the field."""
    rng = np.random.default_rng(seed)
    far_T = sum(beside(gap, rng).getB(places_m) for gap in (6.0, rng.uniform(6.0, 16.0), 20.0))
    far_T *= RMS_T / np.sqrt((far_T**2).sum(1).mean())
    axis, sign, edge_mm = rng.integers(3), rng.choice([-1.0, 1.0]), rng.uniform(0.3, 1.5)
    place_mm = rng.uniform(-6.0, 6.0, 3)
    place_mm[axis] = sign * (5.0 + rng.uniform(0.4, 2.0) + 0.5 * edge_mm)
    small = magpylib.magnet.Cuboid(
        dimension=3 * [1e-3 * edge_mm], position=1e-3 * place_mm, polarization=rng.normal(size=3)
    )
    near_T = small.getB(places_m)
    near_T *= 0.1 * RMS_T / np.sqrt((near_T**2).sum(1).mean())
    return np.stack([one + rng.normal(0.0, NOISE_T, one.shape) for one in (far_T, far_T + near_T)])


if __name__ == "__main__":
    main()
