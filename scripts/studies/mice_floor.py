"""What a diagnosis left of a MICE map, beside what nothing could have taken: the scatter of repeats, and smooth functions in hindsight.

For each diagnosis that `scripts.studies.diagnose_real` wrote: the error on unseen readings; the scatter of readings that were repeated, as
it would be at the unseen places; and the error if each probe's rest were predicted, too, from its seen readings by the best of many smooth
functions of the mapper's place and angle. That one is chosen by the unseen readings themselves, so no correction that is a smooth function
of place and angle, chosen by the seen ones, is expected below it.

A map that repeats no reading, as run01, has its scatter from those of the full maps of the same probes, where their field is no stronger
than it is anywhere in the map. It has few unseen readings, so that chance decides much: with several seeds each diagnosis has other
readings unseen (those of `diagnose_real --seed N --out OUT/seedN`), and all are told together.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from estimator import block_split, load_rig
from estimator.diagnosis import policy
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from scripts.studies.diagnose_real import MICE, session_of

LENGTHS_M = (0.05, 0.1, 0.2, 0.5, 3.0)  # along the rail
LENGTHS_OF_ANGLE = (0.3, 0.7, 1.5, 5.0)  # of cosine and sine of the disc's angle
SHARES = (0.3, 1.0, 3.0)  # of the amplitude that the rest has where the field is strong
SAME_PLACE_M, SAME_ANGLE_DEG = 1e-3, 1.0
TINY_T = 1e-12  # of the field, where nothing is predicted
FULL_MAPS = ("mice-run03", "mice-run05", "mice-run07")


@dataclass(frozen=True)
class Rest:
    """What is left of a map.

    Attributes:
        rest_T, field_T: Readings minus predictions, and predictions.
        along_m, angle_rad, sensor: Where the mapper stood, how its disc was turned, and which probe was read.
        is_unseen: Readings that no fit has seen.
    """

    rest_T: Float[np.ndarray, "reading 3"]
    field_T: Float[np.ndarray, "reading 3"]
    along_m: Float[np.ndarray, " reading"]
    angle_rad: Float[np.ndarray, " reading"]
    sensor: Int[np.ndarray, " reading"]
    is_unseen: Bool[np.ndarray, " reading"]

    @property
    def n_probes(self) -> int:
        """Number of probes."""
        return int(self.sensor.max()) + 1


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="+", help="data sets, such as mice-run07")
    parser.add_argument("--out", type=Path, default=Path("out/diagnosis"), help="where their diagnoses are")
    parser.add_argument(
        "--seeds",
        type=int,
        nargs="+",
        default=[1],
        help="of these diagnoses; where there are several, each is in its own folder, OUT/seedN",
    )
    options = parser.parse_args()
    if not os.environ.get("COILCAL_DATA"):
        sys.exit("mice_floor: COILCAL_DATA must name the folder with the measured maps; it is not set")
    torch.set_num_threads(1)
    for name in options.names:
        rests = []
        for seed in options.seeds:
            out = options.out / f"seed{seed}" if len(options.seeds) > 1 else options.out
            rests.append(rest_of(name, out / name, seed))
        squares_T2 = repeats_T2(name, rests[0])
        told = []
        for seed, rest in zip(options.seeds, rests, strict=True):
            told.append(tell(f"{name}, seed {seed}", rest, squares_T2))
        if len(rests) > 1:
            tell_together(name, rests, squares_T2, np.array(told))


def tell(label: str, rest: Rest, squares_T2: Float[np.ndarray, " probe"]) -> tuple[float, float, float]:
    """One diagnosis: error on unseen readings, scatter of repeats, and error beside the best smooth function, in mT."""
    unseen = rest.is_unseen
    left, scatter = rms_mT(rest.rest_T[unseen]), 1e3 * weighed_T(rest, squares_T2)
    value, words = best_smooth(rest)
    print(
        f"{label}: {unseen.sum()} readings unseen, {left:.3f} mT left of them, {rms_mT(rest.rest_T[~unseen]):.3f} of the others"
    )
    counts = np.bincount(rest.sensor[unseen], minlength=rest.n_probes)
    print(f"  left of each probe: {of_probes([rest])} mT; unseen of each: {', '.join(map(str, counts))}")
    print(f"  repeats scatter by {scatter:.3f} mT, as weighed by the probes of the unseen readings")
    print(
        f"  {value:.3f} mT with the best of {len(SETTINGS)} smooth functions in hindsight ({words})",
        flush=True,
    )
    return left, scatter, value


def tell_together(
    name: str, rests: list[Rest], squares_T2: Float[np.ndarray, " probe"], told: Float[np.ndarray, "seed 3"]
) -> None:
    """All diagnoses of a map: mean and scatter over seeds, and each probe with its unseen readings together."""
    (mean, *others), sd = told.mean(0), told.std(0, ddof=1)
    ratio, chance = told[:, 0] / told[:, 1], np.mean([(6.0 * rest.is_unseen.sum()) ** -0.5 for rest in rests])
    print(
        f"{name}, {len(rests)} seeds: {mean:.4f} mT left of unseen readings, standard deviation {sd[0]:.4f}"
    )
    print(f"  repeats scatter by {others[0]:.4f} mT (standard deviation {sd[1]:.4f}), weighed likewise")
    print(
        f"  left over scatter: {ratio.mean():.3f}, standard deviation {ratio.std(ddof=1):.3f}; by chance alone {chance:.3f}"
    )
    print(f"  {others[1]:.4f} mT with the best smooth function of each seed in hindsight ({sd[2]:.4f})")
    print(f"  left of each probe, all seeds together: {of_probes(rests)} mT")
    print(f"  its repeats scatter by {', '.join(f'{1e3 * square**0.5:.3f}' for square in squares_T2)} mT")


def of_probes(rests: list[Rest]) -> str:
    """What is left of the unseen readings of each probe, in mT."""
    sensor = np.concatenate([rest.sensor[rest.is_unseen] for rest in rests])
    left_T = np.concatenate([rest.rest_T[rest.is_unseen] for rest in rests])
    each = [left_T[sensor == k] for k in range(rests[0].n_probes)]
    return ", ".join(f"{rms_mT(own_T):.3f}" if len(own_T) else "-" for own_T in each)


def rest_of(name: str, folder: Path, seed: int) -> Rest:
    """What the diagnosis in a folder left of all readings."""
    observations = readings_of(name)
    if not (folder / "rig_extended.yaml").exists():
        sys.exit(f"mice_floor: {folder} must hold a diagnosis of scripts.studies.diagnose_real; it does not")
    rig = load_rig(folder / "rig_extended.yaml")
    fitted = json.loads((folder / "diagnosis.json").read_text())["rig_parameters"]
    rig = rig.with_values({name: row["median"] for name, row in fitted.items()})
    values = {name: torch.tensor(v, dtype=torch.float64) for name, v in rig.nominal_values().items()}
    with torch.no_grad():
        field_T = MeasurementModel.build(rig, observations).predict(values)
    motion = observations.motion["mapper"].numpy()
    return Rest(
        (observations.field_sensor_T - field_T).numpy(),
        field_T.numpy(),
        motion[:, 2],
        motion[:, 5],
        observations.sensor.numpy(),
        _unseen(observations, seed),
    )


def _unseen(observations: Observations, seed: int) -> Bool[np.ndarray, " reading"]:
    """Readings that a diagnosis with this seed kept unseen."""
    is_unseen: Bool[np.ndarray, " reading"] = block_split(observations, policy.VALIDATION_SHARE, seed).numpy()
    return is_unseen


def rms_mT(rest_T: Float[np.ndarray, "reading 3"]) -> float:
    return 1e3 * float(np.sqrt((rest_T**2).sum(1).mean()))


def readings_of(name: str) -> Observations:
    data_set = next(data_set for data_set in MICE if data_set.name == name)
    return session_of(data_set, Path(os.environ["COILCAL_DATA"])).observations


def repeats_T2(name: str, rest: Rest) -> Float[np.ndarray, " probe"]:
    """Mean square of the scatter of one reading of each probe: of the map's own repeats, or of full maps where the field is as weak."""
    pairs = Pairs.of(rest.rest_T, rest.along_m, rest.angle_rad, rest.sensor)
    if len(pairs.probe):
        return pairs.mean_square_T2(rest.n_probes)
    strongest_T = float(np.linalg.norm(rest.field_T + rest.rest_T, axis=1).max())
    weak = []
    for full in FULL_MAPS:
        observations = readings_of(full)
        measured_T, motion = observations.field_sensor_T.numpy(), observations.motion["mapper"].numpy()
        both = Pairs.of(measured_T, motion[:, 2], motion[:, 5], observations.sensor.numpy())
        is_weak = np.linalg.norm(measured_T[both.row], axis=1) <= strongest_T
        weak.append(Pairs(both.apart_T[is_weak], both.probe[is_weak], both.row[is_weak]))
    pairs = Pairs(*(np.concatenate(part) for part in zip(*weak, strict=True)))
    counts = ", ".join(map(str, np.bincount(pairs.probe, minlength=rest.n_probes)))
    print(
        f"{name} repeats no reading: scatter of {counts} pairs of its probes in {', '.join(FULL_MAPS)}, in fields up to "
        f"{1e3 * strongest_T:.2f} mT"
    )
    return pairs.mean_square_T2(rest.n_probes)


class Pairs(NamedTuple):
    """Readings of one probe at the same place and angle.

    Attributes:
        apart_T: Their difference.
        row: Of the later reading.
    """

    apart_T: Float[np.ndarray, "pair 3"]
    probe: Int[np.ndarray, " pair"]
    row: Int[np.ndarray, " pair"]

    @classmethod
    def of(
        cls,
        field_T: Float[np.ndarray, "reading 3"],
        along_m: Float[np.ndarray, " reading"],
        angle_rad: Float[np.ndarray, " reading"],
        sensor: Int[np.ndarray, " reading"],
    ) -> Pairs:
        """One of each reading that was repeated and the one before it."""
        degrees = np.degrees(angle_rad) % 360.0
        key = np.stack((sensor, np.round(along_m / SAME_PLACE_M), np.round(degrees / SAME_ANGLE_DEG)), axis=1)
        _, place = np.unique(key, axis=0, return_inverse=True)
        order = np.argsort(place, kind="stable")
        is_pair = place[order][1:] == place[order][:-1]
        row = order[1:][is_pair]
        return cls(np.diff(field_T[order], axis=0)[is_pair], sensor[row], row)

    def mean_square_T2(self, n_probes: int) -> Float[np.ndarray, " probe"]:
        """Of one reading of each probe."""
        square_T2 = 0.5 * (self.apart_T**2).sum(1)
        return np.array([square_T2[self.probe == k].mean() for k in range(n_probes)])


def weighed_T(rest: Rest, squares_T2: Float[np.ndarray, " probe"]) -> float:
    """Rms length of the scatter of one reading, weighed as probes are unseen."""
    share = np.bincount(rest.sensor[rest.is_unseen], minlength=len(squares_T2)) / rest.is_unseen.sum()
    return float(np.sqrt(share @ squares_T2))


SETTINGS = tuple(product(LENGTHS_M, LENGTHS_OF_ANGLE, SHARES, (False, True)))


def best_smooth(rest: Rest) -> tuple[float, str]:
    """Error on unseen readings with the best smooth function of each probe, in mT, and which that is."""
    left = [(rms_mT(_smoothed(rest, *setting)), setting) for setting in SETTINGS]
    value, (length_m, length_of_angle, share, grows) = min(left)
    field = "in proportion to the field" if grows else "everywhere alike"
    return (
        value,
        f"{length_m:g} m along the rail, {length_of_angle:g} in angle, {field}, {share:g} of its rms",
    )


def _smoothed(
    rest: Rest, length_m: float, length_of_angle: float, share: float, grows: bool
) -> Float[np.ndarray, "unseen 3"]:
    """What is left of the unseen readings beside Gaussian processes, one for each probe, given its seen readings.

    Args:
        rest: What is left of the map.
        length_m, length_of_angle: Scales of the covariance.
        share: Standard deviation of the process over the rms of what is left of the seen readings.
        grows: Whether it goes with the field.
    """
    left_T = rest.rest_T.copy()
    strength_T = np.linalg.norm(rest.field_T, axis=1)
    for k in range(rest.sensor.max() + 1):
        is_own = rest.sensor == k
        seen, unseen = np.flatnonzero(is_own & ~rest.is_unseen), np.flatnonzero(is_own & rest.is_unseen)
        rms_T = float(np.sqrt((rest.rest_T[seen] ** 2).mean()))
        typical_T = max(float(np.sqrt((strength_T[seen] ** 2).mean())), TINY_T)
        size = strength_T / typical_T if grows else np.ones_like(strength_T)

        def covariance(a: np.ndarray, b: np.ndarray, size: np.ndarray = size) -> Float[np.ndarray, "a b"]:
            along = (rest.along_m[a][:, None] - rest.along_m[b]) / length_m
            turned = 2.0 * np.sin(0.5 * (rest.angle_rad[a][:, None] - rest.angle_rad[b])) / length_of_angle
            product: Float[np.ndarray, "a b"] = (
                size[a][:, None] * size[b] * share**2 * np.exp(-0.5 * (along**2 + turned**2))
            )
            return product

        noise = 0.5 * np.eye(len(seen))  # variance over the mean square of what is left
        weights = np.linalg.solve(covariance(seen, seen) + noise, rest.rest_T[seen] / rms_T)
        left_T[unseen] -= rms_T * covariance(unseen, seen) @ weights
    return left_T[rest.is_unseen]


if __name__ == "__main__":
    main()
