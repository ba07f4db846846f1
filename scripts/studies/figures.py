"""Copies figures of `make demo`, `real`, `diagnose-real`, `mice-filaments` and `paper` to docs/figures."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

from estimator import Calibration
from estimator.calibration.figures import pictures

ROOT = Path(__file__).resolve().parents[2]
WANTED = {
    "demo/calibration": {
        "demo_posterior": "Posterior",
        "demo_field": "Field of coil1",
        "demo_residual": "Residual around coil1",
    },
    "out/real/mice-run07": {
        "mice_run07_residual": "Residual around M1",
    },
    "out/real/goettingen-long": {"goettingen_long_predicted": "Predicted against measured"},
}
PAPER = (
    "residual_causes",
    "rmse_interactions",
    "valley",
    "relative_error_start",
    "relative_error_calibrated",
    "angle_calibrated",
    "twin_relative_error_literal",
    "twin_relative_error_extended",
    "twin_angle_literal",
    "twin_angle_extended",
)


def main() -> None:
    folder = ROOT / "docs/figures"
    folder.mkdir(parents=True, exist_ok=True)
    for source, names in WANTED.items():
        if not (ROOT / source / "summary.json").exists():
            print(f"{source} holds no calibration; its figures stay as they are", file=sys.stderr)
            continue
        by_title = {picture.title: picture.figure for picture in pictures(Calibration.load(ROOT / source))}
        for file, title in names.items():
            by_title[title].savefig(folder / f"{file}.png", dpi=90, bbox_inches="tight")
            print(folder / f"{file}.png")
    copies = {f"paper_{name}": f"out/paper/{name}.png" for name in PAPER}
    copies["mice_run03_ladder"] = "out/diagnosis/mice-run03/what_each_cause_brought.png"
    copies["mice_run01_without_current"] = "out/mice_filaments/without_current.png"
    for name, path in copies.items():
        if (ROOT / path).exists():
            print(shutil.copyfile(ROOT / path, folder / f"{name}.png"))
        else:
            print(f"{path} is missing; its copy stays as it is", file=sys.stderr)


if __name__ == "__main__":
    main()
