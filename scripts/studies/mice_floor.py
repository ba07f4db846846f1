"""What a diagnosis left of a MICE map, beside what nothing could have taken: the scatter of repeats, and smooth functions in hindsight.

For each diagnosis that `scripts.studies.diagnose_real` wrote: the error on unseen readings; the scatter of readings that were repeated, as
it would be at the unseen places; and the error if each probe's rest were predicted, too, from its seen readings by the best of many smooth
functions of the mapper's place and angle. That one is chosen by the unseen readings themselves, so no correction that is a smooth function
of place and angle, chosen by the seen ones, is expected below it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path

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


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="+", help="data sets, such as mice-run07")
    parser.add_argument("--out", type=Path, default=Path("out/diagnosis"), help="where their diagnoses are")
    parser.add_argument("--seed", type=int, default=1, help="of these diagnoses")
    options = parser.parse_args()
    if not os.environ.get("COILCAL_DATA"):
        sys.exit("mice_floor: COILCAL_DATA must name the folder with the measured maps; it is not set")
    torch.set_num_threads(1)
    for name in options.names:
        rest = rest_of(name, options.out / name, options.seed)
        unseen = rest.is_unseen
        print(
            f"{name}: {unseen.sum()} readings unseen, {rms_mT(rest.rest_T[unseen]):.3f} mT left of them, "
            f"{rms_mT(rest.rest_T[~unseen]):.3f} of the others"
        )
        each = (rms_mT(rest.rest_T[unseen & (rest.sensor == k)]) for k in range(rest.sensor.max() + 1))
        print(f"  left of each probe: {', '.join(f'{value:.3f}' for value in each)} mT")
        print(
            f"  repeats scatter by {scatter_T(rest) * 1e3:.3f} mT, as weighed by the probes of the unseen readings"
        )
        value, words = best_smooth(rest)
        print(
            f"  {value:.3f} mT with the best of {len(SETTINGS)} smooth functions in hindsight ({words})",
            flush=True,
        )


def rest_of(name: str, folder: Path, seed: int) -> Rest:
    """What the diagnosis in a folder left of all readings."""
    data_set = next(data_set for data_set in MICE if data_set.name == name)
    observations = session_of(data_set, Path(os.environ["COILCAL_DATA"])).observations
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


def scatter_T(rest: Rest) -> float:
    """Rms length of the scatter of one reading, by pairs of the same probe at the same place and angle, weighed as probes are unseen."""
    degrees = np.degrees(rest.angle_rad) % 360.0
    key = np.stack(
        (rest.sensor, np.round(rest.along_m / SAME_PLACE_M), np.round(degrees / SAME_ANGLE_DEG)), axis=1
    )
    _, place = np.unique(key, axis=0, return_inverse=True)
    order = np.argsort(place, kind="stable")
    is_pair = place[order][1:] == place[order][:-1]
    apart_T = np.diff(rest.rest_T[order], axis=0)[is_pair]
    probe = rest.sensor[order][1:][is_pair]
    square_T2 = [0.5 * (apart_T[probe == k] ** 2).sum(1).mean() for k in range(rest.sensor.max() + 1)]
    share = np.bincount(rest.sensor[rest.is_unseen], minlength=len(square_T2)) / rest.is_unseen.sum()
    return float(np.sqrt(share @ np.array(square_T2)))


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
        size = strength_T / np.sqrt((strength_T[seen] ** 2).mean()) if grows else np.ones_like(strength_T)

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
