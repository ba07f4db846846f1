"""A coil that is mounted anew between sessions: do the intervals of all versions of `coilcal recalibrate` hold the truth?

`make study NAME=remounted` runs it. Independent code draws coils, noise and places; each coil is measured, then twice mounted up to 3 mm
elsewhere and measured again. Loop counts whose posterior is one whole number are right or wrong, and count as in or out.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from estimator import Registry, recalibrate
from scripts.studies.hidden_cases import session_of, share_and_interval
from tests.hidden.flaw import record
from tests.hidden.handed_in import HiddenSession
from tests.hidden.session import draw_ideal

SHIFT_M = 3e-3
VISITS = 3
FAR_SD = 4.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--coils", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=8000)
    options = parser.parse_args()
    concluded = Counter[str]()
    inside, distances = defaultdict[int, list[bool]](list), defaultdict[int, list[float]](list)
    for seed in range(options.first_seed, options.first_seed + options.coils):
        with tempfile.TemporaryDirectory() as folder:
            conclusions, numbers = measured(seed, Path(folder))
            concluded.update(conclusions[1:])
            for version, is_inside, distance_sd in numbers:
                inside[version].append(is_inside)
                distances[version].append(distance_sd)
        print(f"coil {seed}: {', '.join(conclusions)}", flush=True)
    print(f"conclusions on coils mounted anew: {dict(concluded)}")
    for version, own in sorted(inside.items()):
        n_far = sum(distance > FAR_SD for distance in distances[version])
        print(
            f"version {version}: {share_and_interval(sum(own), len(own))} of 90 % intervals hold the truth; "
            f"{n_far} medians are more than {FAR_SD:g} standard deviations from it"
        )


def measured(seed: int, folder: Path) -> tuple[list[str], list[tuple[int, bool, float]]]:
    """Conclusions on all visits of one coil; then version, whether the interval holds the truth, and the distance of each number."""
    rng = np.random.default_rng([8102, seed])
    first = draw_ideal("paper", rng)
    conclusions, truths = list[str](), dict[int, dict[str, float]]()
    for n in range(1, VISITS + 1):
        shift_m = np.zeros(3) if n == 1 else rng.uniform(-SHIFT_M, SHIFT_M, size=3)
        scene = replace(first, coil_position_m=first.coil_position_m + shift_m)
        made = record(scene, (), rng.normal(size=(len(scene.schedule), 3)))
        hidden = HiddenSession(seed, scene, (), (), made, made, has_neighbour=False)
        session = replace(session_of(hidden), created=f"2026-03-0{n}T09:00:00+00:00")
        session.save(folder / "inbox" / f"{n}.zarr")
        (entry,) = recalibrate(session.rig, folder / "inbox", folder / "registry", seed=seed)
        conclusions.append(entry.conclusion)
        if entry.made is not None:
            truths[entry.made] = hidden.truth()["values"]
    registry, numbers = Registry(folder / "registry"), []
    for version, values in truths.items():
        parameters = registry.calibration(version).summary()["parameters"]
        for name, number in parameters.items():
            if not number["is_derived"]:
                truth, (low, high) = (
                    values.get(name, 0.0),
                    number["ci90"],
                )  # a cause that was named is not there
                distance_sd = abs(truth - number["median"]) / number["sd"] if number["sd"] else 0.0
                numbers.append((version, low <= truth <= high, distance_sd))
    return conclusions, numbers


if __name__ == "__main__":
    main()
