"""A simulated year of monthly sessions: one coil mounted anew in May, and a cause that begins in September; prints every conclusion.

    python -m scripts.studies.recalibrate_year --cause coil_heating.loss_per_A2=2e-3 --out out/year

Its output is in docs/notebook/recalibrations.md.
"""

from __future__ import annotations

import argparse
import json
from datetime import UTC, datetime
from pathlib import Path

from estimator import Session, draw_truth, load_plan, load_rig, recalibrate, simulate

ROOT = Path(__file__).resolve().parents[2]
REMOUNTED, BEGINS = 5, 9  # months
SHIFT_M = 1e-3


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rig", type=Path, default=ROOT / "configs/paper_simulation.yaml")
    parser.add_argument("--plan", type=Path, default=ROOT / "configs/plans/routine_check.yaml")
    parser.add_argument("--cause", default="offset_drift.x_T_per_h=1e-4", metavar="CAUSE=SIZE")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/year"), help="folder for inbox and registry")
    options = parser.parse_args()
    rig = load_rig(options.rig)
    plan = load_plan(options.plan, rig)
    name, _, size = options.cause.partition("=")
    truth = draw_truth(rig, options.seed)
    pose = next(name for name in truth if name.endswith(".z_m"))
    inbox = options.out / "inbox"
    for month in range(1, 13):
        truth_now = dict(truth)
        truth_now[pose] += SHIFT_M if month >= REMOUNTED else 0.0
        hidden = {name: float(size)} if month >= BEGINS else {}
        readings = simulate(rig, plan, truth_now, 100 * options.seed + month, hidden)
        taken = datetime(2026, month, 1, 9, tzinfo=UTC).isoformat()
        source = f"simulated, month {month}, " + json.dumps(hidden)
        Session(rig, readings, source, taken).save(inbox / f"{month:02d}.zarr", overwrite=True)
    recalibrate(
        rig,
        inbox,
        options.out / "registry",
        seed=options.seed,
        on_entry=lambda entry: print(
            f"{entry.taken[:7]}  {entry.conclusion:9}  version {entry.version}  {entry.reason}"
            + (f"; since {entry.since[:7]}" if entry.since else ""),
            flush=True,
        ),
    )


if __name__ == "__main__":
    main()
