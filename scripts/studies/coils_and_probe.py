"""Two coils mapped by a probe, by independent code, with soft brackets, a screw beside the probe, other flaws or none: what is named.

`make coils-and-probe` runs it.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.hidden_cases import share_and_interval
from tests.hidden.protocols import Array
from tests.hidden.pulled_pair import PulledPair, Truth, write
from tests.hidden.screwed_probe import ScrewedProbe

STIFF = (0.0, 0.0)


class Shown(NamedTuple):
    """A probe that shows the field as a matrix says."""

    pair: PulledPair
    matrix: Array

    def field_T(self, currents_A: Array, at_m: Array) -> Array:
        """What is shown at points."""
        return np.asarray(self.pair.field_T(currents_A, at_m) @ self.matrix.T)


class Elsewhere(NamedTuple):
    """A map that is larger than it says along one axis."""

    pair: PulledPair
    factor: Array

    def field_T(self, currents_A: Array, at_m: Array) -> Array:
        """What is there when the mapper says to stand at points."""
        return self.pair.field_T(currents_A, at_m * self.factor)


def nothing(rng: np.random.Generator) -> Truth:
    """Stiff brackets, and no iron."""
    return PulledPair(STIFF, rng)


def soft_brackets(rng: np.random.Generator) -> Truth:
    """Both give way by a quarter to one millimetre under a newton."""
    first, second = np.exp(rng.uniform(np.log(2.5e-4), np.log(1e-3), 2))
    return PulledPair((first, second), rng)


def one_soft_bracket(rng: np.random.Generator) -> Truth:
    """The right one does."""
    return PulledPair((0.0, float(np.exp(rng.uniform(np.log(2.5e-4), np.log(1e-3))))), rng)


def screw(rng: np.random.Generator) -> Truth:
    """Like a ball of 2.5 to 4 mm, 12 to 25 mm from the probe."""
    direction = rng.normal(size=3)
    place_m = rng.uniform(0.012, 0.025) * direction / np.linalg.norm(direction)
    return ScrewedProbe(PulledPair(STIFF, rng), place_m, rng.uniform(2.5e-3, 4e-3))


def gain(rng: np.random.Generator) -> Truth:
    """One axis shows up to 2 % too much or too little."""
    matrix = np.eye(3)
    axis = int(rng.integers(3))
    matrix[axis, axis] += rng.choice((-1.0, 1.0)) * rng.uniform(0.005, 0.02)
    return Shown(PulledPair(STIFF, rng), matrix)


def mixing(rng: np.random.Generator) -> Truth:
    """One axis shows up to 2 % of another."""
    matrix = np.eye(3)
    to, of = rng.permutation(3)[:2]
    matrix[to, of] = rng.choice((-1.0, 1.0)) * rng.uniform(0.005, 0.02)
    return Shown(PulledPair(STIFF, rng), matrix)


def stretched_map(rng: np.random.Generator) -> Truth:
    """One axis of the mapper goes up to 2 % farther than it says."""
    factor = np.ones(3)
    factor[int(rng.integers(3))] += rng.uniform(0.005, 0.02)
    return Elsewhere(PulledPair(STIFF, rng), factor)


KINDS: Mapping[str, tuple[Callable[[np.random.Generator], Truth], frozenset[str]]] = {
    "nothing": (nothing, frozenset()),
    "soft brackets": (soft_brackets, frozenset({"coil_pulled[left]", "coil_pulled[right]"})),
    "one soft bracket": (one_soft_bracket, frozenset({"coil_pulled[right]"})),
    "a screw": (screw, frozenset({"iron_on_sensor"})),
    "a gain": (gain, frozenset({"axis_gain"})),
    "mixing": (mixing, frozenset({"cross_axis"})),
    "a stretched map": (stretched_map, frozenset({"robot_scale"})),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20, help="sessions of each kind")
    parser.add_argument("--first-seed", type=int, default=1000)
    options = parser.parse_args()
    for kind, (truth_of, names) in KINDS.items():
        outcomes = [
            outcome(truth_of, seed) for seed in range(options.first_seed, options.first_seed + options.cases)
        ]
        right = sum(found == names for _, found in outcomes)
        print(
            f"{kind}: {share_and_interval(right, len(outcomes))} end with these names and no others: {', '.join(sorted(names)) or 'none'}"
        )
        for (verdict, found), number in Counter(outcomes).most_common():
            print(f"  {number} {verdict}: {', '.join(sorted(found)) or 'no name'}", flush=True)


def outcome(truth_of: Callable[[np.random.Generator], Truth], seed: int) -> tuple[str, frozenset[str]]:
    """Verdict and names of one session."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        write(Path(folder), truth_of(rng), 20, rng)
        session = read_readings_csv(Path(folder) / "readings.csv", load_rig(Path(folder) / "rig.yaml"))
    diagnosis = diagnose(session, seed=seed)
    return str(diagnosis.verdict), frozenset(diagnosis.label(named.cause) for named in diagnosis.causes)


if __name__ == "__main__":
    main()
