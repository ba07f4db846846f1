"""An example to edit: simulate sessions of one rig, calibrate them all from Python, open the results.

Replace `days()` with your own sessions. On Slurm, pass the address of a Dask scheduler (docs/how-to/run-on-slurm.md).
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from estimator import SamplerSettings, Session, batch, load_plan, load_rig, simulate

CONFIGS = Path(__file__).resolve().parent.parent / "configs"


def days(folder: Path, number: int) -> list[Path]:
    """Sessions of one rig whose coil grows by 20 um a day."""
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    plan = load_plan(CONFIGS / "plans/paper_grid.yaml", rig)
    paths = [folder / f"day{day:03d}.zarr" for day in range(number)]
    for day, path in enumerate(paths):
        truth = {"coil1.radius_m": 0.051 + 20e-6 * day}
        if not path.exists():
            Session(rig, simulate(rig, plan, truth, seed=day), f"simulated day {day}", truth=truth).save(path)
    return paths


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=int, default=8)
    parser.add_argument("--out", type=Path, default=Path("out/batch"))
    parser.add_argument("--scheduler", help="such as tcp://host:8786; processes of this computer by default")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    result = batch(
        days(options.out, options.days),
        out=options.out,
        hypotheses=("plain", "axis_gain"),
        settings=SamplerSettings(target_ess=400.0),
        scheduler=options.scheduler,
        tell=lambda done, total, words: print(f"{done} of {total}: {words}", file=sys.stderr),
    )
    result.save_table(options.out)
    table = result.table()
    print(
        table[["job", "probability", "is_sampled", "coil1.radius_m", "coil1.radius_m.sd"]].to_string(
            index=False
        )
    )
    arrays = result.dataset()  # xarray: job x parameter
    print(arrays["median"].sel(parameter="coil1.radius_m").groupby("hypothesis").mean())
    first = table[table["is_sampled"]]["job"].iloc[0]
    print(result.calibration(first).summary()["loop_counts"][:1])
    radius = result.calibration(first).summary()["parameters"]["coil1.radius_m"]
    print(f"effective samples: {radius['ess_bulk']:.0f}")


if __name__ == "__main__":
    main()
