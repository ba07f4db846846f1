"""First calibrations of laboratories with ordinary things that no rig file mentions: which are `good`, and which of these are wrong.

The Earth's field, a zero, gains, and a mount that is off may be there. The readings are by other code (tests/hidden/first_session.py).
`make first-calibrations` runs it; each session is appended to a file as it ends, so an interrupted study continues.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.inference.ensemble import SamplerSettings
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.starter import Motion, Moved, Starter, starter_rig_text
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.hidden_cases import share_and_interval
from tests.hidden.first_session import FirstSession, first_session

# An interval is false where the truth is further from the median: 1 in 16000 for a right one
FAR_SD = 4.0
LEAST_PROBABILITY = 1e-3  # of the true loop counts
N_DRAWS = 400


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=300)
    parser.add_argument("--first-seed", type=int, default=54000)
    parser.add_argument("--as-described", action="store_true", help="fit the rig file as it is")
    parser.add_argument("--out", type=Path, default=Path("out/first_calibrations.jsonl"))
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    done = {row["seed"]: row for row in map(json.loads, lines)}
    seeds = range(options.first_seed, options.first_seed + options.sessions)
    with options.out.open("a") as file:
        for seed in seeds:
            if seed not in done:
                done[seed] = judged(seed, options.as_described)
                file.write(json.dumps(done[seed]) + "\n")
                file.flush()
    show([done[seed] for seed in seeds])


def judged(seed: int, as_described: bool) -> dict[str, Any]:
    """Calibrate a session as a user would who has answered `coilcal init`, and compare with the truth."""
    made = first_session(seed)
    answers = {
        **made.answers,
        "moved": Moved(made.answers["moved"]),
        "motion": Motion(made.answers["motion"]),
    }
    rig = rig_from_text(starter_rig_text(Starter(**answers)), "rig.yaml")  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "readings.csv"
        with path.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(made.columns)
            writer.writerows([[f"{number:.9g}" for number in row] for row in made.rows])
        session = read_readings_csv(path, rig)
    calibration = calibrate(
        session,
        seed=seed,
        settings=SamplerSettings(target_ess=400.0, max_steps=1500),
        as_described=as_described,
    )
    summary = calibration.summary()
    distances_sd = {**_numbers_sd(calibration, made.truth), **_fields_sd(calibration, made)}
    probability = _probability_of_counts(summary, made.truth)
    false = [name for name, distance_sd in distances_sd.items() if abs(distance_sd) > FAR_SD]
    false += ["loop counts"] if probability is not None and probability < LEAST_PROBABILITY else []
    return {
        "seed": seed,
        "protocol": made.protocol,
        "moved": made.answers["moved"],
        "motion": made.answers["motion"],
        "ordinary": made.ordinary,
        "verdict": summary["quality"]["verdict"],
        "reasons": summary["quality"]["reasons"],
        "false": false,
        "distances_sd": distances_sd,
        "probability_of_counts": probability,
        "stated_counts": summary["loop_counts"][:1],
        "true_counts": [made.truth["coil1.axial_loops"], made.truth["coil1.radial_loops"]],
    }


def _numbers_sd(calibration: Calibration, truth: Mapping[str, float]) -> dict[str, float]:
    """Distance of the truth from the median in standard deviations, of each number that is no count."""
    return {
        name: float((value - np.median(calibration.draws[name])) / calibration.draws[name].std())
        for name, value in truth.items()
        if name in calibration.draws and not name.endswith("_loops")
    }


def _fields_sd(calibration: Calibration, made: FirstSession) -> dict[str, float]:
    """The farthest component of the coil's field at places of readings, which is asked with and without current."""
    if not len(made.points_m):
        return {}
    points_m = torch.from_numpy(made.points_m)
    room = calibration.room(points_m, None)
    draws = calibration.draw_values(N_DRAWS)
    current_A = {"coil1": float(made.answers["largest_A"])}  # type: ignore[arg-type]
    with_current, without = (room.field_T(draws, calibration.currents(on)) for on in (current_A, {}))
    field_T = with_current - without
    off_sd = (torch.from_numpy(made.coil_field_T) - field_T.median(dim=0).values) / field_T.std(dim=0)
    return {"field": float(off_sd.flatten()[off_sd.abs().argmax()])}


def _probability_of_counts(summary: Mapping[str, Any], truth: Mapping[str, float]) -> float | None:
    if not summary["loop_counts"]:
        return None
    true = (truth["coil1.axial_loops"], truth["coil1.radial_loops"])
    return sum(c["probability"] for c in summary["loop_counts"] if (c["axial"], c["radial"]) == true)


def show(rows: list[dict[str, Any]]) -> None:
    """Verdicts, and how many of the good ones hold a false interval."""
    verdicts = Counter(row["verdict"] for row in rows)
    print(f"{len(rows)} first calibrations: " + ", ".join(f"{n} {v}" for v, n in verdicts.most_common()))
    good = [row for row in rows if row["verdict"] == "good"]
    wrong = [row for row in good if row["false"]]
    print(f"good with a false interval: {share_and_interval(len(wrong), len(rows))}")
    print(f"  of those that are good:   {share_and_interval(len(wrong), len(good))}")
    for name in ("nothing", "earth", "zero", "gain", "gains", "shift", "turn"):
        having = [
            row for row in rows if (name in row["ordinary"] if name != "nothing" else not row["ordinary"])
        ]
        n_good = sum(row["verdict"] == "good" for row in having)
        print(f"  with {name:8} {len(having):4}, good {n_good:4}")
    for protocol in dict.fromkeys(row["protocol"] for row in rows):
        having = [row for row in rows if row["protocol"] == protocol]
        n_good = sum(row["verdict"] == "good" for row in having)
        print(f"  currents {protocol:14} {len(having):4}, good {n_good:4}")
    inside = [abs(d) < 1.645 for row in good for name, d in row["distances_sd"].items() if name != "field"]
    print(
        f"90 % intervals of good calibrations hold the truth: {share_and_interval(sum(inside), len(inside))}"
    )
    sure = [row for row in good if row["stated_counts"] and row["stated_counts"][0]["probability"] > 0.9]
    right = [
        row
        for row in sure
        if [row["stated_counts"][0]["axial"], row["stated_counts"][0]["radial"]] == row["true_counts"]
    ]
    print(
        f"loop counts stated at over 90 % in good calibrations are right: {share_and_interval(len(right), len(sure))}"
    )
    for row in wrong:
        print(
            f"  seed {row['seed']}: {row['protocol']}, {row['moved']} {row['motion']}, {row['ordinary']}: {row['false']}"
        )


if __name__ == "__main__":
    main()
