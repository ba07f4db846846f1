"""Unknown sources beside a bore, followed by the waves of `coil_bore` alone: error and coverage of 90 % intervals inside and beyond.

Twelve fields by magpylib: dipoles, an iron sphere's, windings of the opposite sense, tilted loops. 171 places, noise of a thirtieth of the
field, degree and width by evidence as in a diagnosis. The block jackknife, by which a diagnosis widens intervals, is left out.
"""

from __future__ import annotations

import argparse

import magpylib
import numpy as np
import torch

from estimator.diagnosis import policy
from estimator.effects.corrections.bore import BEYOND, TREND
from estimator.field.bore import WAVES, bore_field

LENGTH = 8.0 + 2.0 * BEYOND  # of the cylinder, in radii
N_CASES, FRESH_SEED = 12, 7200  # turns, widths and length of the waves were chosen on 7000 to 7011
N_FITTED, N_ASKED, NOISE_SHARE = 171, 400, 1.0 / 30.0
DEGREES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 19, 22, 24)
SIGMA90 = 1.645
REGIONS = {  # radii from, to; heights from, to
    "inside": (0.0, 1.0, 0.0, 4.0),
    "beyond the ends, to 0.5 radii": (0.0, 1.0, 4.0, 4.5),
    "0.5 to 1.5 radii": (0.0, 1.0, 4.5, 5.5),
    "2 to 4 radii": (0.0, 1.0, 6.0, 8.0),
    "beyond the wall, to 1.3 radii": (1.0, 1.3, 0.0, 4.0),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first-seed", type=int, default=FRESH_SEED)
    first_seed = parser.parse_args().first_seed
    torch.set_num_threads(1)
    cases = [one_case(seed) for seed in range(first_seed, first_seed + N_CASES)]
    for region in REGIONS:
        coverage, error, sd = np.array([case[region] for case in cases]).T
        print(
            f"{region:30} coverage {coverage.mean():.0%} ({coverage.min():.0%} to {coverage.max():.0%}); medians over the noise: "
            f"error {np.median(error):.2g}, standard deviation {np.median(sd):.2g}"
        )


def one_case(seed: int) -> dict[str, tuple[float, float, float]]:
    """By region: coverage, rms error and rms standard deviation in units of the noise."""
    rng = np.random.default_rng(seed)
    sources = sources_of(seed % 4, rng)
    places = in_cylinder(N_FITTED, (0.0, 1.0, 0.0, 4.0), rng)
    field = magpylib.getB(sources, places, sumup=True)
    noise = NOISE_SHARE * np.sqrt(np.mean(field**2))
    read = (field + noise * rng.normal(size=field.shape)).ravel() / noise
    degree, width = best(read, columns(places, max(DEGREES)))
    design = width * columns(places, degree)
    covariance = np.linalg.inv(np.eye(design.shape[1]) + design.T @ design)
    mean = covariance @ (design.T @ read)
    found = {}
    for name, region in REGIONS.items():
        asked = in_cylinder(N_ASKED, region, rng)
        there = width * columns(asked, degree)
        sd = np.sqrt(((there @ covariance) * there).sum(1))
        error = there @ mean - magpylib.getB(sources, asked, sumup=True).ravel() / noise
        rms = [float(np.sqrt(np.mean(values**2))) for values in (error, sd)]
        found[name] = (float(np.mean(np.abs(error) < SIGMA90 * sd)), rms[0], rms[1])
    return found


def sources_of(kind: int, rng: np.random.Generator) -> list[object]:
    """Two to four radii from the axis."""
    height, azimuth, distance = rng.uniform(-4.0, 4.0), rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.0, 4.0)
    at = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    if kind == 0:
        return [magpylib.misc.Dipole(moment=rng.normal(size=3), position=at)]
    if kind == 1:  # an iron sphere beside a solenoid
        solenoid = [loop(1.7, z) for z in np.linspace(-1.0, 1.0, 21)]
        field = magpylib.getB(solenoid, at, sumup=True)
        return [magpylib.misc.Dipole(moment=field / np.linalg.norm(field), position=at)]
    if kind == 2:  # an outer winding of the opposite sense
        radius = rng.uniform(2.0, 4.0)
        return [loop(radius, height + z, -1.0) for z in np.linspace(-1.0, 1.0, 15)]
    tilted = magpylib.current.Circle(diameter=1.0, current=1.0, position=at)
    opposite = at * np.array([-1.0, -1.0, 0.0]) + np.array([0.0, 0.0, rng.uniform(-4.0, 4.0)])
    return [
        tilted.rotate_from_rotvec(rng.normal(size=3)),
        magpylib.misc.Dipole(moment=rng.normal(size=3), position=opposite),
    ]


def loop(radius: float, height: float, current: float = 1.0) -> object:
    return magpylib.current.Circle(diameter=2.0 * radius, current=current, position=(0.0, 0.0, height))


def in_cylinder(n: int, region: tuple[float, float, float, float], rng: np.random.Generator) -> np.ndarray:
    """Points evenly over a region, at both ends."""
    inner, outer, low, high = region
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    radius = np.sqrt(rng.uniform(inner**2, outer**2, n))
    height = rng.uniform(low, high, n) * rng.choice([-1.0, 1.0], n)
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), height), axis=1)


def columns(places: np.ndarray, degree: int) -> np.ndarray:
    """Component by amplitude."""
    points = torch.from_numpy(places)
    trend, wave = (torch.eye(len(names), dtype=torch.float64) for names in (TREND, WAVES))
    fields = [bore_field(points, LENGTH, trend, {})]
    fields += [bore_field(points, LENGTH, None, {n: wave}) for n in range(1, degree + 1)]
    return torch.cat(fields).flatten(1).T.numpy()


def best(read: np.ndarray, every: np.ndarray) -> tuple[int, float]:
    """Degree and width of the amplitudes with most evidence."""
    options = []
    for degree in DEGREES:
        design = every[:, : len(TREND) + degree * len(WAVES)]
        scale = float(np.sqrt(np.mean(np.sum(design**2, axis=1))))
        for rms in policy.AMPLITUDES:
            scaled = design * (rms / scale)
            precision = np.eye(design.shape[1]) + scaled.T @ scaled
            score = scaled.T @ read
            evidence = 0.5 * (score @ np.linalg.solve(precision, score) - np.linalg.slogdet(precision)[1])
            options.append((float(evidence), degree, rms / scale))
    return max(options)[1:]


if __name__ == "__main__":
    main()
