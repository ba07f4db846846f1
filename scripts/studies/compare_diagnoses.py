"""Independent diagnoses of one rig side by side: a line for every quantity that differs clearly from zero in all of them.

    python -m scripts.studies.compare_diagnoses out/diagnosis/mice-run03 out/diagnosis_with_plate/mice-run05

It prints a table in Markdown, and for every two of them how many of the shared quantities agree within their intervals.
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
from estimator.reporting.numbers import with_sd

CLEAR_SD = 5.0  # least distance from zero in every diagnosis
PREFIXES = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "T": ("µT", 1e6), "1": ("%", 1e2)}

Sized = tuple[float, float]  # value and its standard deviation


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path, help="folders written by coilcal diagnose")
    folders: list[Path] = parser.parse_args().folders
    for folder in folders:
        if not (folder / DIAGNOSIS).is_file():
            sys.exit(f"compare_diagnoses: folders must hold a {DIAGNOSIS}; received {folder}")
    diagnoses = [quantities(folder) for folder in folders]
    shared = [key for key in diagnoses[0] if all(is_clear(sizes.get(key)) for sizes in diagnoses)]
    print("| cause | quantity | unit | " + " | ".join(folder.name for folder in folders) + " |")
    print("|---" * (3 + len(folders)) + "|")
    for cause, name, unit in shared:
        words, factor = PREFIXES.get(unit, (unit, 1.0))
        values = [
            with_sd(factor * value, factor * sd)
            for value, sd in (sizes[cause, name, unit] for sizes in diagnoses)
        ]
        print(f"| `{cause}` | {name.removesuffix(f'_{unit}')} | {words} | " + " | ".join(values) + " |")
    print()
    for (first_folder, first), (second_folder, second) in combinations(
        zip(folders, diagnoses, strict=True), 2
    ):
        off = [in_sd(first[key], second[key]) for key in first if key in second and first[key][1] > 0.0]
        inside = sum(sd < HALF_WIDTH_90 for sd in off)
        print(
            f"{first_folder.name}, {second_folder.name}: {inside} of {len(off)} shared quantities agree within the 90 % interval of their "
            f"difference; the median difference is {median(off):.2f} standard deviations (expected: 0.67)"
        )


def quantities(folder: Path) -> dict[tuple[str, str, str], Sized]:
    """Every quantity of the named causes, by cause, name and unit."""
    diagnosis = json.loads((folder / DIAGNOSIS).read_text(encoding="utf-8"))
    return {
        (cause["name"], name, numbers["unit"]): (numbers["median"], numbers["sd"])
        for cause in diagnosis["causes"]
        for name, numbers in cause["parameters"].items()
    }


def in_sd(first: Sized, second: Sized) -> float:
    """Difference of two values, in standard deviations of the difference."""
    return abs(first[0] - second[0]) / math.hypot(first[1], second[1])


def is_clear(sized: Sized | None) -> bool:
    return sized is not None and abs(sized[0]) > CLEAR_SD * sized[1] > 0.0


if __name__ == "__main__":
    main()
