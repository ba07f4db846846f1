"""Simulated years of weekly sessions with one cause that begins in week 20: is it named within two weeks?

`make recalibrate-years` runs it. The cause is one of ten, with a random direction and a size between half and all of the largest. `right`
means that the credible set holds the true name with its sensor or coil, `place` that it holds the name at another one. An interrupted year
continues; a finished one is a line of `years.jsonl`. The table at the end covers the seeds that were asked for.
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
name: weekly check, two sensors, both signs of the current and none, positions in random order
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
SETTINGS = SamplerSettings(
    target_ess=400.0, max_steps=2000
)  # of new versions, which this study does not test
ALARMS = ("drifted", "rejected")
Row = dict[str, Any]


@dataclass(frozen=True)
class Kind:
    """A cause that may begin: its quantities and their largest size; `is_growing` adds the size again each week.

    A single quantity has the sign of `largest`.
    """

    cause: str
    keys: tuple[str, ...]
    largest: float
    is_growing: bool = False

    def drawn(self, rng: np.random.Generator) -> dict[str, float]:
        """A random direction of the quantities, times a size between half and all of the largest."""
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
    """Run one year through `recalibrate`, and check that each of its versions can be made current again."""
    begin_s = time.process_time()
    rng = np.random.default_rng([20, seed])
    title = list(KINDS)[int(rng.integers(len(KINDS)))]
    size = KINDS[title].drawn(rng)
    folder.mkdir(exist_ok=True)
    (folder / "rig.yaml").write_text((CONFIGS / "paper_simulation.yaml").read_text() + SECOND_SENSOR)
    (folder / "plan.yaml").write_text(PLAN)
    rig = load_rig(folder / "rig.yaml")
    plan, truth = load_plan(folder / "plan.yaml", rig), draw_truth(rig, seed)
    for week in range(1, weeks + 1):
        path = folder / "inbox" / f"{week:02d}.zarr"
        if not path.exists():
            readings = simulate(rig, plan, truth, 100 * seed + week, hidden(KINDS[title], size, week))
            taken = datetime(2026, 1, 5, 9, tzinfo=UTC) + timedelta(weeks=week - 1)
            Session(rig, readings, f"simulated, week {week}", taken.isoformat()).save(path)
    registry = Registry(folder / "registry")
    recalibrate(rig, folder / "inbox", registry.folder, seed=seed, settings=SETTINGS)
    entries = [entry for entry in registry.entries() if entry.hash]
    check_versions(registry)
    return {
        "seed": seed,
        "words": title,
        "cause": KINDS[title].cause,
        "size": size,
        "seconds": time.process_time() - begin_s,
        "weeks": [
            {
                "conclusion": entry.conclusion,
                "version": entry.version,
                "p_value": entry.checks.get("p_value"),
                "since": entry.since,
                "named": [
                    [cause["name"], *(other["name"] for other in cause["alternatives"])]
                    for cause in entry.causes
                ],
                "reason": entry.reason,
            }
            for entry in entries
        ],
    }


def check_versions(registry: Registry) -> None:
    """Make every version current again, undamaged, the last time the one that is current now."""
    current = registry.current
    assert current is not None
    others = [version for version in registry.versions if version != current]
    for version in (*others, current) if others else ():
        with registry.writing():
            registry.roll_back(version)
        if (
            registry.current != version
            or registry.calibration().summary() != registry.calibration(version).summary()
        ):
            raise RuntimeError(f"version {version} must be current again; {registry.current} is")


def hidden(kind: Kind, size: Mapping[str, float], week: int) -> dict[str, float]:
    """Quantities of the cause in a week's session."""
    since = week - BEGINS + 1
    if since < 1:
        return {}
    return {name: value * (since if kind.is_growing else 1) for name, value in size.items()}


def alarms(row: Row) -> list[int]:
    """Weeks with an alarm before the cause begins."""
    early = row["weeks"][: BEGINS - 1]
    return [i for i, week in enumerate(early, start=1) if week["conclusion"] in ALARMS]


def drift(row: Row) -> tuple[int, list[list[str]]] | None:
    """Week of the first drift after the cause began, and the credible sets of names."""
    for number, week in enumerate(row["weeks"][BEGINS - 1 :], start=BEGINS):
        if week["conclusion"] == "drifted":
            return number, week["named"]
    return None


def is_right(row: Row) -> bool:
    """Whether `drifted` came within two weeks with one cause whose credible set holds the true name, at any place."""
    first = drift(row)
    if first is None or first[0] >= BEGINS + WITHIN or len(first[1]) != 1:
        return False
    return without_place(row["cause"]) in map(without_place, first[1][0])


def is_strict(row: Row) -> bool:
    """Whether the place is right too: the sensor or coil that changed. Names leave it out where there is only one."""
    first = drift(row)
    names = () if first is None else first[1][0]
    return is_right(row) and (row["cause"] in names or without_place(row["cause"]) in names)


def needless(row: Row) -> list[int]:
    """Weeks before the cause begins that led to a needless new version."""
    early = row["weeks"][1 : BEGINS - 1]
    return [i for i, week in enumerate(early, start=2) if week["conclusion"] == "updated"]


def is_first(row: Row) -> bool:
    """Whether the true name is also the most probable one."""
    first = drift(row)
    return (
        is_right(row) and first is not None and without_place(first[1][0][0]) == without_place(row["cause"])
    )


def without_place(name: str) -> str:
    return name.partition("[")[0]


def line(row: Row) -> str:
    first = drift(row)
    told = (
        "never"
        if first is None
        else f"week {first[0]}: " + " and ".join(" or ".join(names) for names in first[1])
    )
    size = math.sqrt(sum(value**2 for value in row["size"].values()))
    early = "; before: " + ", ".join(f"week {week}" for week in alarms(row)) if alarms(row) else ""
    judged = "right" if is_strict(row) else "place" if is_right(row) else "WRONG"
    return f"{row['seed']} {judged}  {row['cause']} {size:.2g} -> {told}{early} ({row['seconds']:.0f} s)"


def show(rows: list[Row]) -> None:
    for row in rows:
        print(line(row))
        counts = Counter(week["conclusion"] for week in row["weeks"])
        print("  " + ", ".join(f"{number} {conclusion}" for conclusion, number in counts.items()))
        for number, week in enumerate(row["weeks"][1:], start=2):
            if week["conclusion"] != "unchanged":
                print(f"  week {number}: {week['conclusion']}, {week['reason']}")
    n, quiet = len(rows), sum(not alarms(row) for row in rows)
    right, first = sum(map(is_right, rows)), sum(map(is_first, rows))
    print(f"no alarm before week {BEGINS}: {quiet} of {n}")
    strict, updates = sum(map(is_strict, rows)), sum(len(needless(row)) for row in rows)
    print(
        f"drifted within {WITHIN} weeks, the true name in the only credible set: {right} of {n}, most probable: {first}"
    )
    print(f"  with the true sensor or coil: {strict} of {n} (otherwise marked `place`)")
    print(f"needless new versions before week {BEGINS}: {updates}")


if __name__ == "__main__":
    main()
