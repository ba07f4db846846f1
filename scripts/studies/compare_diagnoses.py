"""What several diagnoses of one rig, each by itself, say of the same causes: a line for every quantity that all of them tell from zero.

    python -m scripts.studies.compare_diagnoses out/diagnosis/mice-run03 out/diagnosis_with_plate/mice-run05

It prints a table in Markdown, and of every two of them how many numbers that both give differ by no more than their intervals say.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from itertools import combinations
from pathlib import Path
from statistics import median

from estimator.diagnosis.result import DIAGNOSIS
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.reporting.plots.style import with_sd

CLEAR_SD = 5.0  # from zero, in every diagnosis
PREFIXES = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "T": ("µT", 1e6), "1": ("%", 1e2)}

Sized = tuple[float, float]  # value and its standard deviation


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path, help="that coilcal diagnose wrote")
    folders: list[Path] = parser.parse_args().folders
    for folder in folders:
        if not (folder / DIAGNOSIS).is_file():
            sys.exit(f"compare_diagnoses: folders must hold a {DIAGNOSIS}; received {folder}")
    found = [quantities(folder) for folder in folders]
    shared = [key for key in found[0] if all(is_clear(one.get(key)) for one in found)]
    print("| cause | quantity | unit | " + " | ".join(folder.name for folder in folders) + " |")
    print("|---" * (3 + len(folders)) + "|")
    for cause, name, unit in shared:
        words, factor = PREFIXES.get(unit, (unit, 1.0))
        values = [
            with_sd(factor * value, factor * sd) for value, sd in (one[cause, name, unit] for one in found)
        ]
        print(f"| `{cause}` | {name.removesuffix(f'_{unit}')} | {words} | " + " | ".join(values) + " |")
    print()
    for (one, first), (other, second) in combinations(zip(folders, found, strict=True), 2):
        off = [in_sd(first[key], second[key]) for key in first if key in second and first[key][1] > 0.0]
        inside = sum(sd < HALF_WIDTH_90 for sd in off)
        print(
            f"{one.name}, {other.name}: {inside} of {len(off)} numbers that both give differ by no more than the 90 % interval of their "
            f"difference; the median is {median(off):.2f} standard deviations, where 0.67 is due"
        )


def quantities(folder: Path) -> dict[tuple[str, str, str], Sized]:
    """Every quantity of what a diagnosis named, by cause, name and unit."""
    record = json.loads((folder / DIAGNOSIS).read_text(encoding="utf-8"))
    return {
        (cause["name"], name, p["unit"]): (p["median"], p["sd"])
        for cause in record["causes"]
        for name, p in cause["parameters"].items()
    }


def in_sd(one: Sized, other: Sized) -> float:
    """Difference of two values in its standard deviations."""
    return abs(one[0] - other[0]) / math.hypot(one[1], other[1])


def is_clear(sized: Sized | None) -> bool:
    return sized is not None and abs(sized[0]) > CLEAR_SD * sized[1] > 0.0


if __name__ == "__main__":
    main()
