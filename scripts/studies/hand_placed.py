"""Sessions in which a hand puts the probe at marks: whether errors that the readings of a mark share are told as that, with their size.

Marks, currents, errors of placement and one further flaw are drawn by independent code; `make study NAME=hand-placed` runs it. Beside
errors that a mark's readings share there are sessions with an error of its own at each reading, and sessions with none.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from estimator import Diagnosis, diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.hidden_cases import share_and_interval
from tests.hidden.far_plate import COIL, FRONT_M
from tests.hidden.hand_placed import draw_hand, write_hand_placed

KINDS = {"shared by a mark": True, "of each reading": False, "none": None}
TRUTHS = {
    **{f"coil1.{key}": COIL[key] for key in ("radius_m", "wire_radius_m", "axial_loops", "radial_loops")},
    **{f"coil1.world_from_coil.{axis}_m": at_m for axis, at_m in zip("xyz", FRONT_M, strict=True)},
}
STOPS, JITTER = "stop_errors[stage]", "position_jitter[stage]"


class Outcome(NamedTuple):
    """What a diagnosis said of the placement, its size over the true one, other names, and numbers of the coil inside their intervals."""

    said: str
    ratio: float
    others: tuple[str, ...]
    inside: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20, help="sessions of each kind")
    parser.add_argument("--first-seed", type=int, default=1000)
    options = parser.parse_args()
    for kind, is_shared in KINDS.items():
        seeds = range(options.first_seed, options.first_seed + options.cases)
        outcomes = [outcome(is_shared, seed) for seed in seeds]
        told = defaultdict[str, list[Outcome]](list)
        for each in outcomes:
            told[each.said].append(each)
        print(f"errors {kind}:")
        for said, some in told.items():
            ratios = np.nanquantile([each.ratio for each in some], (0.0, 0.5, 1.0))
            size = f"; size over the true one {ratios[1]:.2f} ({ratios[0]:.2f} to {ratios[2]:.2f})"
            print(
                f"  {said} in {share_and_interval(len(some), len(outcomes))}{size * (not np.isnan(ratios[1]))}"
            )
        named = [name for each in outcomes for name in each.others]
        print(f"  other names: {', '.join(named) or 'none'}")
        inside = sum(each.inside for each in outcomes)
        print(
            f"  coil inside 90 % intervals: {share_and_interval(inside, len(TRUTHS) * len(outcomes))}",
            flush=True,
        )


def outcome(is_shared: bool | None, seed: int) -> Outcome:
    """Draw a session, diagnose it, and compare."""
    rng = np.random.default_rng([8101, seed])
    hand = draw_hand(rng)
    if is_shared is None:
        hand = hand._replace(scatter_m=0.0)
    with tempfile.TemporaryDirectory() as folder:
        write_hand_placed(Path(folder), hand, rng, is_shared is not False)
        session = read_readings_csv(Path(folder) / "readings.csv", load_rig(Path(folder) / "rig.yaml"))
    diagnosis = diagnose(session, seed=seed, has_posterior=True)
    names = [named.cause.label for named in diagnosis.causes]
    said, size_m = _placement(diagnosis, names)
    intervals = diagnosis.rig_numbers()
    inside = sum(intervals[n].ci90[0] <= truth <= intervals[n].ci90[1] for n, truth in TRUTHS.items())
    others = tuple(name for name in names if name != JITTER)
    return Outcome(said, size_m / hand.scatter_m if hand.scatter_m else np.nan, others, inside)


def _placement(diagnosis: Diagnosis, names: Sequence[str]) -> tuple[str, float]:
    """What is said of the placement, and how large it is."""
    rig, values = diagnosis.fits.final.rig, diagnosis.fits.final.values
    if JITTER in names:
        return "scatter of single readings", float(values[f"{JITTER}.sd_m"])
    of_stops = [entry for entry in diagnosis.findings.answer.beside if entry.first.cause.label == STOPS]
    widths = [p.prior.sd for p in rig.free if p.name.startswith(f"{STOPS}.") and p.prior is not None]
    if of_stops:
        return "errors of marks", widths[0] if widths else np.nan
    return ("something else" if diagnosis.verdict.leaves_something else "nothing"), np.nan


if __name__ == "__main__":
    main()
