"""Simulated years of weekly sessions, in each of which one cause begins in week 20: is it told within two weeks, by its name?

`make recalibrate-years` runs it. The cause is drawn from ten, its size between half and all of the largest, its direction in space by
chance. `right` says that the true name stands in the set with its sensor or coil, `place` that it does at another one. A year that was
cut off goes on, and one that ended is a line of `years.jsonl`; the table at the end is of the seeds that were asked for.
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from estimator import (
    Registry,
    SamplerSettings,
    Session,
    draw_truth,
    load_plan,
    load_rig,
    recalibrate,
    simulate,
)

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
BEGINS, WITHIN = 20, 2  # weeks
SECOND_SENSOR = """\
  hall_turned:
    noise_uT: {prior: {log_normal: {median: 20, relative_sd: 0.5}}}
    world_from_sensor: {x_mm: 9, y_mm: -7, z_mm: 2, rx_rad: 0.9, ry_rad: -0.7, rz_rad: 0.4}
"""
PLAN = """\
schema_version: 1
name: weekly check, two sensors, both signs of the current and none, places in random order
poses:
  calibration:
    arm1: {x_mm: {from: -50, to: 50}, y_mm: {from: -50, to: 50}, z_mm: {from: -25, to: 25}}
    scattered: 20
  validation:
    arm1: {x_mm: {from: -45, to: 45}, y_mm: {from: -45, to: 45}, z_mm: {from: -22, to: 22}}
    scattered: 8
currents_A: [{coil1: 3}, {coil1: -3}, {}]
order: random
settle_s: 10
"""
SETTINGS = SamplerSettings(target_ess=400.0, max_steps=2000)  # of new versions: this study is not about these
ALARMS = ("drifted", "rejected")
Row = dict[str, Any]


@dataclass(frozen=True)
class Kind:
    """What may begin: quantities of one cause and their largest size; `is_growing` adds the size again each week.

    A single quantity has the sign of `largest`.
    """

    cause: str
    keys: tuple[str, ...]
    largest: float
    is_growing: bool = False

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """A direction over the quantities, times a size between half and all of the largest."""
        direction = rng.normal(size=len(self.keys)) if len(self.keys) > 1 else np.ones(1)
        size = self.largest * rng.uniform(0.5, 1.0)
        values = size * direction / np.linalg.norm(direction)
        return {f"{self.cause}.{key}": float(value) for key, value in zip(self.keys, values, strict=True)}


KINDS = {
    "the coil heats up, its supply at its limit": Kind("coil_heating", ("loss_per_A2",), 2e-3),
    "an ageing supply": Kind("current_gain", ("excess",), -0.02, is_growing=True),
    "a bumped sensor": Kind("sensor_misplaced[hall_turned]", ("x_m", "y_m", "z_m"), 1e-3),
    "a sensor whose zero drifts": Kind("offset_drift[hall]", ("x_T_per_h", "y_T_per_h", "z_T_per_h"), 300e-6),
    "a sensor with a new zero": Kind("sensor_offset[hall_turned]", ("x_T", "y_T", "z_T"), 60e-6),
    "a sensor whose axes read too much": Kind("axis_gain[hall]", ("x", "y", "z"), 0.02),
    "a sensor whose axes mix": Kind("cross_axis[hall]", ("xy", "yx", "xz", "zx", "yz", "zy"), 0.02),
    "a magnet left in the room": Kind("background_field", ("x_T", "y_T", "z_T"), 60e-6),
    "an arm with wrong lengths": Kind("robot_scale", ("x", "y", "z"), 0.02),
    "a coil askew on its flange": Kind("mount_tilt[coil1]", ("x_rad", "y_rad"), math.radians(1.5)),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=4000)
    parser.add_argument("--weeks", type=int, default=52)
    parser.add_argument("--out", type=Path, default=Path("out/years"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    lines = options.out / "years.jsonl"
    rows = (
        {row["seed"]: row for row in map(json.loads, lines.read_text().splitlines())}
        if lines.exists()
        else {}
    )
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    for seed in seeds:
        if seed in rows:
            continue
        rows[seed] = year(seed, options.weeks, options.out / str(seed))
        with lines.open("a", encoding="utf-8") as file:
            file.write(json.dumps(rows[seed]) + "\n")
        shutil.rmtree(options.out / str(seed))
        print(line(rows[seed]), file=sys.stderr, flush=True)
    show([rows[seed] for seed in seeds])


def year(seed: int, weeks: int, folder: Path) -> Row:
    """One year through `recalibrate`, and that all its versions can be opened and made current again."""
    begin_s = time.process_time()
    rng = np.random.default_rng([20, seed])
    words = list(KINDS)[int(rng.integers(len(KINDS)))]
    size = KINDS[words].drawn(rng)
    folder.mkdir(exist_ok=True)
    (folder / "rig.yaml").write_text((CONFIGS / "paper_simulation.yaml").read_text() + SECOND_SENSOR)
    (folder / "plan.yaml").write_text(PLAN)
    rig = load_rig(folder / "rig.yaml")
    plan, truth = load_plan(folder / "plan.yaml", rig), draw_truth(rig, seed)
    for week in range(1, weeks + 1):
        path = folder / "inbox" / f"{week:02d}.zarr"
        if not path.exists():
            readings = simulate(rig, plan, truth, 100 * seed + week, hidden(KINDS[words], size, week))
            taken = datetime(2026, 1, 5, 9, tzinfo=UTC) + timedelta(weeks=week - 1)
            Session(rig, readings, f"simulated, week {week}", taken.isoformat()).save(path)
    registry = Registry(folder / "registry")
    recalibrate(rig, folder / "inbox", registry.folder, seed=seed, settings=SETTINGS)
    entries = [entry for entry in registry.entries() if entry.hash]
    check_versions(registry)
    return {
        "seed": seed,
        "words": words,
        "cause": KINDS[words].cause,
        "size": size,
        "seconds": time.process_time() - begin_s,
        "weeks": [
            {
                "conclusion": entry.conclusion,
                "version": entry.version,
                "p_value": entry.checks.get("p_value"),
                "since": entry.since,
                "named": [[c["name"], *(o["name"] for o in c["alternatives"])] for c in entry.causes],
                "reason": entry.reason,
            }
            for entry in entries
        ],
    }


def check_versions(registry: Registry) -> None:
    """Every version can be made current again, whole; in the end that is the one that was."""
    last = registry.current
    assert last is not None
    for version in (*registry.versions, last):
        with registry.writing():
            registry.roll_back(version)
        if (
            registry.current != version
            or registry.calibration().summary() != registry.calibration(version).summary()
        ):
            raise RuntimeError(f"version {version} must be current again; {registry.current} is")


def hidden(kind: Kind, size: Mapping[str, float], week: int) -> dict[str, float]:
    """What a week's session holds of the cause."""
    since = week - BEGINS + 1
    if since < 1:
        return {}
    return {name: value * (since if kind.is_growing else 1) for name, value in size.items()}


def alarms(row: Row) -> list[int]:
    """Weeks before the cause begins in which something was told."""
    early = row["weeks"][: BEGINS - 1]
    return [i for i, week in enumerate(early, start=1) if week["conclusion"] in ALARMS]


def drift(row: Row) -> tuple[int, list[list[str]]] | None:
    """Week of the first drift after the cause began, and the sets of names."""
    for number, week in enumerate(row["weeks"][BEGINS - 1 :], start=BEGINS):
        if week["conclusion"] == "drifted":
            return number, week["named"]
    return None


def is_right(row: Row) -> bool:
    """Whether `drifted` came within two weeks with one cause whose set of names holds the true one, at whatever place."""
    found = drift(row)
    if found is None or found[0] >= BEGINS + WITHIN or len(found[1]) != 1:
        return False
    return without_place(row["cause"]) in map(without_place, found[1][0])


def is_strict(row: Row) -> bool:
    """The same, with the place of the cause too: the sensor that was touched; where there is only one place, names leave it out."""
    found = drift(row)
    names = () if found is None else found[1][0]
    return is_right(row) and (row["cause"] in names or without_place(row["cause"]) in names)


def needless(row: Row) -> list[int]:
    """Weeks before the cause begins that led to a new version, which nothing called for."""
    early = row["weeks"][1 : BEGINS - 1]
    return [i for i, week in enumerate(early, start=2) if week["conclusion"] == "updated"]


def is_first(row: Row) -> bool:
    """The same, with the true name in front."""
    found = drift(row)
    return (
        is_right(row) and found is not None and without_place(found[1][0][0]) == without_place(row["cause"])
    )


def without_place(name: str) -> str:
    return name.partition("[")[0]


def line(row: Row) -> str:
    found = drift(row)
    told = "never" if found is None else f"week {found[0]}: " + " and ".join(" or ".join(s) for s in found[1])
    size = math.sqrt(sum(value**2 for value in row["size"].values()))
    early = "; before: " + ", ".join(f"week {week}" for week in alarms(row)) if alarms(row) else ""
    judged = "right" if is_strict(row) else "place" if is_right(row) else "WRONG"
    return f"{row['seed']} {judged}  {row['cause']} {size:.2g} -> {told}{early} ({row['seconds']:.0f} s)"


def show(rows: list[Row]) -> None:
    for row in rows:
        print(line(row))
        counts = Counter(week["conclusion"] for week in row["weeks"])
        print("  " + ", ".join(f"{number} {words}" for words, number in counts.items()))
        for number, week in enumerate(row["weeks"][1:], start=2):
            if week["conclusion"] != "unchanged":
                print(f"  week {number}: {week['conclusion']}, {week['reason']}")
    n, quiet = len(rows), sum(not alarms(row) for row in rows)
    right, first = sum(map(is_right, rows)), sum(map(is_first, rows))
    print(f"no alarm before week {BEGINS}: {quiet} of {n}")
    strict, updates = sum(map(is_strict, rows)), sum(len(needless(row)) for row in rows)
    print(
        f"drifted within {WITHIN} weeks with the true name in the one set that is named: {right} of {n}, in front: {first}"
    )
    print(f"  the true sensor or coil beside it too: {strict} of {n} (`place` where it is another one)")
    print(f"new versions before week {BEGINS} that nothing called for: {updates}")


if __name__ == "__main__":
    main()
