"""A repeat on measured data: MICE run06, a quick look at coil M1, then run07, its full map, through `recalibrate`.

`make recalibrate-mice` runs it and prints each conclusion with its reason; it needs the maps of a public repository in the folder named by
COILCAL_DATA (see the README). It takes a random part of the full map, because a diagnosis of all 11514 readings takes long; `--readings 0`
takes all. After an interruption it continues with the run that has no conclusion yet.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

import torch

from estimator import Registry, load_rig, recalibrate
from estimator.readings.split import thinned
from estimator.recalibration.log import Entry
from estimator.store.importers import IMPORTERS

RIG = Path(__file__).resolve().parents[2] / "configs/mice_ssu_m1.yaml"
RUNS = {"run06": "2018-03-21T10:58:36", "run07": "2018-03-21T11:18:55"}  # start of each


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readings", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/recalibrate_mice"))
    options = parser.parse_args()
    data = os.environ.get("COILCAL_DATA")
    if not data:
        sys.exit("recalibrate_mice: COILCAL_DATA must name the folder with the measured maps; it is not set")
    torch.set_num_threads(1)
    rig = load_rig(RIG)
    for run, created in RUNS.items():
        path = options.out / "inbox" / f"{run}.zarr"
        if not path.exists():
            files = sorted((Path(data) / "mice-ssu-solenoids").glob(f"{run}*.dat"))
            session = IMPORTERS["mice"](files, rig, {"M1": 30.0})
            readings = thinned(
                session.observations, options.readings or len(session.observations), options.seed
            )
            print(f"{run}: {len(readings)} of {len(session.observations)} readings")
            replace(session, observations=readings, created=created).save(path)
    registry = Registry(options.out / "registry")
    recalibrate(rig, options.out / "inbox", registry.folder, seed=options.seed)
    for entry in registry.entries():
        show(entry)
    history = registry.history()
    print(history["median"].to_pandas().T.to_string())
    print((history["sd"]).to_pandas().T.to_string())


def show(entry: Entry) -> None:
    print(f"{Path(entry.session).stem}: {entry.conclusion}, version {entry.version}; {entry.reason}")
    for cause in entry.causes:
        sizes = [
            f"{key} {numbers['median']:.4g} ± {numbers['sd']:.1g} {numbers['unit']}"
            for key, numbers in cause["parameters"].items()
        ]
        alternatives = [alternative["name"] for alternative in cause["alternatives"]]
        print(
            f"  {' or '.join([cause['name'], *alternatives])} ({cause['log_bayes_factor']:+.0f}): {', '.join(sizes)}"
        )
    for name, value in entry.checks.items():
        print(f"  {name}: {value}")


if __name__ == "__main__":
    main()
