"""Posteriors of sessions whose cause is not in the library: whether they hold the truth; `make unexplained-posteriors` runs it.

Only sessions that end `unexplained` count. For each parameter of a coil its true value is looked for in the 90 % interval, once of the fit
alone and once of what a diagnosis gives, widened by what is left. Where loop counts are whole numbers, the probability that was given to
the most probable ones is held against whether they are right.
"""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean
from typing import Any

import numpy as np

from estimator import Calibration, Session
from estimator.calibration.summary import summary
from estimator.diagnosis.posterior import extended_posterior
from estimator.effects import EFFECTS
from scripts.studies.hidden_cases import (
    Row,
    diagnosed_session,
    gather,
    options_of,
    row_of,
    share_and_interval,
)
from tests.hidden.study import OPEN_KINDS, draw_case

ALONE, WIDENED = "of the fit alone", "widened"


def main() -> None:
    options = options_of(
        __doc__,
        [kind for kind in OPEN_KINDS if kind.startswith("unknown")],
        20,
        60_000,
        "out/unexplained_posteriors.jsonl",
    ).parse_args()
    show([row for row in gather(options, run_case) if row["posteriors"]])


def run_case(kind: str, seed: int) -> Row:
    """Hide what is in no library, diagnose, and draw parameters where it ends `unexplained`."""
    hidden = draw_case(kind, seed, EFFECTS)
    session, diagnosis, seconds = diagnosed_session(hidden, seed)
    row = row_of(kind, hidden, diagnosis, seconds) | {"posteriors": {}}
    widening = diagnosis.left_open.widening
    if widening is not None:
        truth = hidden.truth()["values"]
        none = replace(widening, covariance=widening.fit.covariance)
        row["posteriors"] = {
            name: _judged(
                session, extended_posterior(session, diagnosis.extended_rig, each, seed=seed), truth
            )
            for name, each in ((ALONE, none), (WIDENED, widening))
        }
    return row


def _judged(session: Session, posterior: Calibration, truth: dict[str, float]) -> dict[str, Any]:
    """Whether true values lie in the intervals, and what is said of loop counts."""
    numbers = summary(session, posterior)
    coils = tuple(f"{coil.name}." for coil in posterior.rig.wound)
    inside = {
        name: bool(entry["ci90"][0] <= truth[name] <= entry["ci90"][1])
        for name, entry in numbers["parameters"].items()
        if name in truth and name.startswith(coils)
    }
    sizes = {name: float(np.std(posterior.draws[name])) for name in inside}
    return {"inside": inside, "sd": sizes, "counts": _counts(numbers["loop_counts"], truth)}


def _counts(entries: list[dict[str, Any]], truth: dict[str, float]) -> list[dict[str, Any]]:
    """Of each coil the most probable loop counts: their probability, and whether they are right."""
    best: dict[str, dict[str, Any]] = {}
    for entry in entries:
        if entry["probability"] > best.get(entry["coil"], {"probability": 0.0})["probability"]:
            best[entry["coil"]] = entry
    return [
        {
            "probability": entry["probability"],
            "is_right": all(
                truth.get(f"{coil}.{way}_loops", entry[way]) == entry[way] for way in ("axial", "radial")
            ),
        }
        for coil, entry in best.items()
    ]


def show(rows: list[Row]) -> None:
    print(f"{len(rows)} sessions that end unexplained")
    for name in (ALONE, WIDENED):
        posteriors = [row["posteriors"][name] for row in rows]
        inside = [
            is_in for p in posteriors for key, is_in in p["inside"].items() if not key.endswith("_loops")
        ]
        of_counts = [
            is_in for p in posteriors for key, is_in in p["inside"].items() if key.endswith("_loops")
        ]
        counts = [count for p in posteriors for count in p["counts"]]
        print(
            f"{name}: true values inside their 90 % intervals {share_and_interval(sum(inside), len(inside))}"
        )
        print(f"  loop counts inside theirs {share_and_interval(sum(of_counts), len(of_counts))}")
        if counts:
            right = share_and_interval(sum(count["is_right"] for count in counts), len(counts))
            stated = fmean(count["probability"] for count in counts)
            print(f"  most probable whole counts: stated {stated:.1%} in the mean, right in {right}")


if __name__ == "__main__":
    main()
