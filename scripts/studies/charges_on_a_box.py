"""Charges on a box beside harmonics in a ball, on places held out of a cube of 10 mm: magnets near it, or maps of eight coils.

Coils without a winding by both, each with a prior whose rms field is 1.3 mT, as that of the fields is. Amplitudes are integrated out, and
the noise has its most probable value, so no chain is needed. `--maps` needs the folder named by COILCAL_DATA.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import magpylib
import numpy as np
import torch

from estimator.model.coil_field import unwound_field
from estimator.rig.rig import Rig
from estimator.store.importers.common import map_observations
from estimator.store.importers.grid_maps import read_grid_maps
from estimator.store.session import Session
from scripts.studies.harmonic_coils import BOX, FOLDER, HARMONICS, N_FOLDS, eight_coils, folds, one_coil

RMS_T = 1.3e-3
NOISE_T = 1e-9  # of the magnets, as little as is left of the smoothest maps
GAPS_MM = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 10.0)
TRIED_NOISE_T = 10.0 ** np.arange(-11.0, -4.0, 0.2)
Z90 = 1.645


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[150021, 150031, 150032, 150033])
    parser.add_argument("--margin", type=float, default=4.0, help="in mm")
    parser.add_argument("--spacing", type=float, default=1.3, help="in mm")
    parser.add_argument("--width", type=float, default=1.0, help="of the prior, over the rms of the fields")
    parser.add_argument("--maps", action="store_true", help="of eight coils; seeds are of folds then")
    options = parser.parse_args()
    torch.set_num_threads(1)
    box = BOX.replace("margin_mm: 4", f"margin_mm: {options.margin}").replace("1.3", f"{options.spacing}")
    rigs = {"box": one_coil(eight_coils(None, box), "c1"), "ball": one_coil(eight_coils(20, HARMONICS), "c1")}
    axis_m = 1e-3 * torch.arange(-5.0, 6.0, dtype=torch.float64)
    places_m = torch.cartesian_prod(axis_m, axis_m, axis_m)
    if options.maps:
        session, fields_T, names = maps()
        places_m = session.observations.motion["stage"][:, :3]
    else:
        names = [f"{gap:g} mm" for gap in GAPS_MM]
        fields_T = np.stack([by_magnets(seed, places_m.numpy()) for seed in options.seeds])
        session = session_at(rigs["box"], places_m)
    splits = options.seeds if options.maps else options.seeds[:1]
    for label, rig in rigs.items():
        design = columns(rig, places_m)
        design *= options.width * RMS_T / np.sqrt((design**2).sum((1, 2)).mean())
        judged = [
            judge(design, field_T, folds(session, seed).numpy()) for seed in splits for field_T in fields_T
        ]
        error, coverage = (np.array(part) for part in zip(*judged, strict=True))
        typical = np.sqrt((error**2).mean(0)) if options.maps else np.exp(np.log(error).mean(0))
        print(f"{label}, {design.shape[-1]} amplitudes")
        for name, share, held in zip(names, typical, coverage.mean(0), strict=True):
            print(
                f"  {name}: error {share:.4%} of the field on places held out, coverage {held:.0%}",
                flush=True,
            )


def by_magnets(seed: int, places_m: np.ndarray) -> np.ndarray:
    """Fields of three magnets: by gap, one that far off the cube, another up to 10 mm farther, a third 20 mm off."""
    rng = np.random.default_rng(seed)
    fields_T = []
    for gap in GAPS_MM:
        gaps = (gap, gap + rng.uniform(0.0, 10.0), 20.0)
        field_T = sum(beside(one, rng).getB(places_m) for one in gaps)
        field_T *= RMS_T / np.sqrt((field_T**2).sum(1).mean())
        fields_T.append(field_T + rng.normal(0.0, NOISE_T, field_T.shape))
    return np.stack(fields_T)


def beside(gap_mm: float, rng: np.random.Generator) -> magpylib.magnet.Cuboid:
    """A magnet of 3 to 20 mm off one face of the cube."""
    size_mm = rng.uniform(3.0, 20.0, 3)
    axis, sign = rng.integers(3), rng.choice([-1.0, 1.0])
    place_mm = rng.uniform(-8.0, 8.0, 3)
    place_mm[axis] = sign * (5.0 + gap_mm + 0.5 * size_mm[axis])
    return magpylib.magnet.Cuboid(
        dimension=1e-3 * size_mm, position=1e-3 * place_mm, polarization=rng.normal(size=3)
    )


def maps() -> tuple[Session, np.ndarray, list[str]]:
    """The eight maps, as one set of fields."""
    rig = eight_coils(None)
    files = sorted((Path(os.environ["COILCAL_DATA"]) / FOLDER).glob("vfield_*.txt"))
    sessions = [read_grid_maps([path], rig) for path in files]
    fields_T = np.stack([session.observations.field_sensor_T.numpy() for session in sessions])
    return sessions[0], fields_T[None], [coil.name for coil in rig.coils]


def session_at(rig: Rig, places_m: torch.Tensor) -> Session:
    """Readings of nothing, for their places."""
    pose = torch.cat((places_m, torch.zeros_like(places_m)), 1)
    observations = map_observations(rig, [1.0], pose, torch.ones_like(places_m))
    return Session(rig, observations, "magnets")


def columns(rig: Rig, places_m: torch.Tensor) -> np.ndarray:
    """Components of the field at places, by prior standard deviations of each amplitude."""
    coil = rig.unwound[0]
    names = [name for of_degree in coil.amplitudes.values() for name in of_degree]
    sd = torch.tensor([prior.sd for name in names if (prior := rig.parameters[name].prior)]).double()
    values = dict(zip(names, torch.diag(sd), strict=True))
    values |= {p.name: torch.tensor(p.value).double() for p in rig.parameters.values() if p.unit == "m"}
    return unwound_field(coil, values).by(None)(places_m).permute(1, 2, 0).numpy().copy()


def judge(design: np.ndarray, fields_T: np.ndarray, fold: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Error over the field, and coverage of 90 % intervals, on places held out, for each field."""
    squares, held = np.zeros(len(fields_T)), np.zeros(len(fields_T))
    for number in range(N_FOLDS):
        seen, unseen = (design[of].reshape(-1, design.shape[-1]) for of in (fold != number, fold == number))
        left, size, right = np.linalg.svd(seen, full_matrices=False)
        along = unseen @ right.T
        beside_all = np.clip((unseen**2).sum(1) - (along**2).sum(1), 0.0, None)
        for i, field_T in enumerate(fields_T):
            measured_T = field_T[fold != number].ravel()
            noise_T, projected_T = most_probable_noise(size, left, measured_T)
            shrunk = size**2 + noise_T**2
            error_T = along @ (size * projected_T / shrunk) - field_T[fold == number].ravel()
            variance = along**2 @ (noise_T**2 / shrunk) + beside_all + noise_T**2
            squares[i] += (error_T**2).sum()
            held[i] += (np.abs(error_T) < Z90 * np.sqrt(variance)).sum()
    return np.sqrt(squares / (fields_T**2).sum((1, 2))), held / fields_T[0].size


def most_probable_noise(
    size: np.ndarray, left: np.ndarray, measured_T: np.ndarray
) -> tuple[float, np.ndarray]:
    """Noise with the largest evidence, and the readings along the combinations that the amplitudes can make."""
    projected_T = left.T @ measured_T
    rest = ((measured_T - left @ projected_T) ** 2).sum()
    variance = size**2 + TRIED_NOISE_T[:, None] ** 2
    log_evidence = -0.5 * (
        (projected_T**2 / variance + np.log(variance)).sum(1)
        + rest / TRIED_NOISE_T**2
        + 2.0 * (len(measured_T) - len(size)) * np.log(TRIED_NOISE_T)
    )
    return float(TRIED_NOISE_T[log_evidence.argmax()]), projected_T


if __name__ == "__main__":
    main()
