"""Flaws that public reports describe, hidden by independent code: how often the answer holds the true one, and what else it says.

A supply that reaches its voltage, cold and warm; fields in the axes of a base or of the room; currents without their sign; a pose or a
reading that is the one before, in each third to tenth row (tests/hidden/reported.py). `clean` has the same sessions without a flaw.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from estimator import diagnose, load_rig
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.hidden_cases import Row, rows_of, share_and_interval
from tests.hidden.reported import KINDS, draw_reported
from tests.hidden.study import credible_sets

OF_SETS: Mapping[str, tuple[str, ...]] = {
    "current_limit": ("current_limit",),
    "sinking_limit": ("current_limit", "coil_heating"),
    "recorded_frame": ("field_frame",),
}
OF_ROWS: Mapping[str, tuple[str, ...]] = {
    "stale_pose": ("pose",),
    "stale_reading": ("reading before", "row before"),
    "unsigned_currents": ("flowed the other way",),
}
FLAWS = (*KINDS, "recorded_frame")
ALL_KINDS = (*FLAWS, "clean")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kinds", nargs="+", choices=ALL_KINDS, default=ALL_KINDS)
    parser.add_argument("--cases", type=int, default=8, help="sessions of each kind")
    parser.add_argument("--first-seed", type=int, default=561_000)
    parser.add_argument("--sigma", type=float, default=12.0, help="visible size of a limit or a frame")
    parser.add_argument(
        "--row-sigma", type=float, default=12.0, help="root mean square change of a wrong row"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/reported_flaws.jsonl"))
    options = parser.parse_args()
    run = partial(run_case, sigma=options.sigma, row_sigma=options.row_sigma)
    for kind in options.kinds:
        cases = [(kind, options.first_seed + i) for i in range(options.cases)]
        show(kind, rows_of(cases, run, options.out, options.workers, str))


def run_case(kind: str, seed: int, sigma: float, row_sigma: float) -> Row:
    """Hide a flaw and diagnose; a `clean` session is one of the others without its flaw, by turns."""
    is_clean = kind == "clean"
    hidden = draw_reported(FLAWS[seed % len(FLAWS)] if is_clean else kind, seed, sigma, row_sigma)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (hidden.right if is_clean else hidden.session).write(folder)
        session = read_readings_csv(folder / "readings.csv", load_rig(folder / "rig.yaml"))
    diagnosis = diagnose(session, seed=seed)
    record = diagnosis.to_json()
    flags = [*diagnosis.findings.flags]
    flagged = {reading for flag in flags for reading in flag.readings}
    wrong = set(hidden.changed.tolist()) if kind in OF_ROWS else set()
    return {
        "kind": kind,
        "seed": seed,
        "sigma": hidden.sigma,
        "row_sigma": hidden.row_sigma,
        "verdict": record["verdict"],
        "sets": credible_sets(record),
        "words": sorted({flag.words for flag in flags}),
        "wrong": len(wrong),
        "flagged": len(flagged & wrong),
        "false": len(flagged - wrong),
    }


def is_held(row: Mapping[str, Any]) -> bool:
    """Whether a credible set, or what is said of rows, holds the true flaw."""
    if names := OF_SETS.get(row["kind"]):
        return any(name in names for members in row["sets"] for name in members)
    return any(part in words for words in row["words"] for part in OF_ROWS[row["kind"]])


def show(kind: str, rows: Sequence[Row]) -> None:
    """Shares of a kind, and its rows."""
    for row in rows:
        print("  ", row)
    rows = [row for row in rows if "error" not in row]
    if kind == "clean":
        alarms = sum(row["verdict"] != "nothing_found" or row["false"] > 0 for row in rows)
        print(f"clean: false alarm in {share_and_interval(alarms, len(rows))}", flush=True)
        return
    others = sum(len(row["sets"]) - (kind in OF_SETS and is_held(row)) for row in rows)
    print(
        f"{kind}: true flaw held in {share_and_interval(sum(map(is_held, rows)), len(rows))}; sets of other causes {others}; wrong rows "
        f"flagged {sum(row['flagged'] for row in rows)} of {sum(row['wrong'] for row in rows)}; right rows flagged "
        f"{sum(row['false'] for row in rows)}",
        flush=True,
    )


if __name__ == "__main__":
    main()
