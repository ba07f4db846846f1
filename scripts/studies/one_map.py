"""Whether ten diagnoses of one map agree, each with other readings for the search and others kept unseen; `make one-map` runs it.

By default two maps by six probes are asked: run03 of the measured MICE solenoids (below COILCAL_DATA), and a simulated bore behind a
pierced plate of iron, with the wrong zero of one probe; other measured maps by their names (`--kinds maxwell-both-coils,mri4all-gradient`).
The seed of a diagnosis draws which readings the search sees, and of a large measured map which 800 readings there are. Every diagnosis is
appended to a file as it ends, so an interrupted study continues.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

from estimator import Diagnosis, Session, diagnose, load_rig
from estimator.readings.split import thinned
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.diagnose_real import MICE, MORE, session_of
from scripts.studies.hidden_cases import Row, gather, options_of
from scripts.studies.real_data import DATA_SETS
from tests.hidden.bore_map import SOLENOID, SOLENOID_TEXT, places_m, write_map
from tests.hidden.coil import blocks_of, circular_field
from tests.hidden.pierced_sheet import pierced_T

MEASURED, SIMULATED = "mice-run03", "simulated"
ARMS_MM = {"p0": (0, 0), "p1": (6, 0), "p2": (0, 12), "p3": (-18, 0), "p4": (0, -24), "p5": (30, 0)}
N_MEASURED = 800
MAPS = {data_set.name: data_set for data_set in (*DATA_SETS, *MORE, *MICE)}
N_PLACES, CURRENT_A = 400, 5.0
PLATE_HEIGHT_M, OPENING_M = 0.23, 0.055
OFFSET_T = (20e-6, -10e-6, 15e-6)  # of probe p3
SEED_OF_MAP = 1


def main() -> None:
    options = options_of(__doc__, (MEASURED, SIMULATED), 10, 1, "out/one_map.jsonl", tuple(MAPS)).parse_args()
    if set(options.kinds.split(",")) & set(MAPS) and not os.environ.get("COILCAL_DATA"):
        sys.exit("one_map: COILCAL_DATA must name the folder with the measured maps; it is not set")
    show(gather(options, run_case), options)


def run_case(kind: str, seed: int) -> Row:
    """One diagnosis of one of the maps."""
    session = simulated_map() if kind == SIMULATED else measured_map(kind, seed)
    begin = time.perf_counter()
    diagnosis = diagnose(session, seed=seed)
    return {**row_of(kind, seed, diagnosis), "seconds": time.perf_counter() - begin}


def measured_map(name: str, seed: int) -> Session:
    """Some readings of a measured map, or all where they are few."""
    session = session_of(MAPS[name], Path(os.environ["COILCAL_DATA"]))
    if len(session.observations) <= N_MEASURED:
        return session
    some = thinned(session.observations, N_MEASURED, seed)
    return replace(session, observations=replace(some, whole=None, chosen=None))


def simulated_map() -> Session:
    """2400 readings by magpylib's loops and a quadrature over the plate, the same at every call."""
    rng = np.random.default_rng(SEED_OF_MAP)
    mapper_m = places_m(N_PLACES, 0.06, 0.4, 0.008, rng)
    current_A = CURRENT_A * rng.choice([-1.0, 0.5, 1.0], N_PLACES)
    coil = circular_field(blocks_of(SOLENOID))
    fields_T = []
    for name, (x_mm, y_mm) in ARMS_MM.items():
        at_m = mapper_m + np.array([x_mm, y_mm, 0.0]) / 1e3
        field_T = current_A[:, None] * pierced_T(coil, PLATE_HEIGHT_M, OPENING_M, at_m)
        fields_T.append(field_T + np.array(OFFSET_T) * (name == "p3"))
    probe = [name for _ in range(N_PLACES) for name in ARMS_MM]
    with tempfile.TemporaryDirectory() as folder:
        write_map(
            Path(folder),
            SOLENOID_TEXT,
            {"solenoid": np.repeat(current_A, len(ARMS_MM))},
            np.repeat(mapper_m, len(ARMS_MM), axis=0),
            np.stack(fields_T, axis=1).reshape(-1, 3),
            rng,
            probe,
            ARMS_MM,
        )
        rig = load_rig(Path(folder) / "rig.yaml")
        return read_readings_csv(Path(folder) / "readings.csv", rig)


def row_of(kind: str, seed: int, diagnosis: Diagnosis) -> Row:
    record = diagnosis.to_json()
    return {
        "kind": kind,
        "seed": seed,
        "protocol": f"{len(diagnosis.fits.final.observations)} readings fitted",
        "truth": [],
        "verdict": record["verdict"],
        "causes": record["causes"],
        "stand_ins": [cause["name"] for cause in record["stand_ins"]],
        "left": record["unexplained"]["log_bayes_factor"],
        "gain": record.get("gain"),
    }


def show(rows: list[Row], options: argparse.Namespace) -> None:
    for kind in options.kinds.split(","):
        mine = [row for row in rows if row["kind"] == kind]
        if mine:
            show_map(kind, mine)


def show_map(kind: str, rows: list[Row]) -> None:
    verdicts = ", ".join(
        f"{verdict} {count}" for verdict, count in Counter(row["verdict"] for row in rows).most_common()
    )
    print(f"{kind}: {len(rows)} diagnoses; {verdicts}")
    named: Counter[str] = Counter()
    standing_in: Counter[str] = Counter()
    sizes = defaultdict(list)
    for row in rows:
        named.update(cause["name"] for cause in row["causes"])
        standing_in.update(row["stand_ins"])
        for cause in row["causes"]:
            for key, interval in cause["parameters"].items():
                sizes[cause["name"], key].append((interval["median"], interval["sd"], interval["unit"]))
    print("  cause                          named    not sure")
    for name in sorted(named | standing_in, key=lambda name: (-named[name], -standing_in[name])):
        print(f"  {name:30} {named[name]:5} {standing_in[name]:11}")
    print(
        "  sizes that every diagnosis gives: mean, scatter between diagnoses, mean stated standard deviation"
    )
    for (name, key), values in sizes.items():
        if len(values) == len(rows) > 1:
            medians, sds = [v[0] for v in values], [v[1] for v in values]
            print(
                f"  {name}.{key}: {np.mean(medians):.4g}, {np.std(medians, ddof=1):.2g}, {np.mean(sds):.2g} {values[0][2]}"
            )
    errors = [row["gain"][when]["vector_T"] for when in ("before", "after") for row in rows if row["gain"]]
    before, after = errors[: len(errors) // 2], errors[len(errors) // 2 :]
    if after:
        print(
            f"  error on unseen readings: {np.mean(before) * 1e3:.3f} mT before, {np.mean(after) * 1e3:.3f} mT after "
            f"({min(after) * 1e3:.3f} to {max(after) * 1e3:.3f})"
        )
    seconds = sorted(row["seconds"] for row in rows)
    print(f"  time of a diagnosis: {seconds[0]:.0f} to {seconds[-1]:.0f} s")


if __name__ == "__main__":
    main()
