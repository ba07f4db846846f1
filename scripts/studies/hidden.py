"""Hides effects in sessions made by independent code and counts how often the diagnosis finds them; `make hidden` runs it.

Every case is appended to a file as it ends, so an interrupted study continues. At the end it prints shares of right and wrong verdicts,
coverage and the confusion matrix.
"""

from __future__ import annotations

import math
import tempfile
from collections import Counter
from itertools import permutations
from pathlib import Path
from typing import Any

from estimator.diagnosis import effort
from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.effects import EFFECTS
from estimator.readings.metrics import HALF_WIDTH_90
from estimator.store.importers.readings_csv import read_readings_csv
from scripts.studies.hidden_cases import Row, diagnosed, gather, noise_T, options_of, row_of, share, truth_of
from tests.hidden.handed_in import HiddenSession
from tests.hidden.study import FIRST_KINDS, KINDS, credible_sets, draw_case, true_quantities

LUCKY_SD = 3.09  # standard deviations that a normal number exceeds once in a thousand


def main() -> None:
    parser = options_of(__doc__, KINDS, 300, 30_000, "out/hidden.jsonl")
    parser.set_defaults(kinds=",".join(FIRST_KINDS))
    show(gather(parser.parse_args(), run_case))


def run_case(kind: str, seed: int) -> Row:
    """Hide effects and diagnose."""
    hidden = draw_case(kind, seed)
    diagnosis, seconds = diagnosed(hidden, seed)
    record = diagnosis.to_json()
    unflawed = fit_without_flaws(hidden, diagnosis.fits.plain) if kind == "single" else None
    return row_of(kind, hidden, diagnosis, seconds) | {
        "twins": record["indistinguishable"],
        "steps": [
            [(c["name"], c["log_bayes_factor"], c["probability"]) for c in step["considered"][:6]]
            for step in record["steps"]
        ],
        "coil": {
            name: {
                "truth": value,
                "before": float(diagnosis.fits.plain.values[name]),
                "after": float(diagnosis.fits.final.values[name]),
                "sd_before": diagnosis.fits.plain.value_sd(name),
                "sd_after": diagnosis.value_sd(name),
                "unflawed": None if unflawed is None else float(unflawed.values[name]),
            }
            for name, value in hidden.truth()["values"].items()
            if name in diagnosis.fits.plain.posterior.coordinates.names and not name.endswith("noise_T")
        },
    }


def fit_without_flaws(hidden: HiddenSession, plain: Fit) -> Fit:
    """Fit of the rig as described to the same readings and noise without the flaw."""
    with tempfile.TemporaryDirectory() as folder:
        hidden.without_flaws().write(Path(folder))
        session = read_readings_csv(Path(folder) / "readings.csv", plain.rig)
    rules = plain.posterior.model.rules
    return fit_rig(plain.rig, session.observations.calibration, plain.values, rules, effort.MORE_STARTS)


def show(rows: list[Row]) -> None:
    by_kind = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}
    for kind in ("single", "discrete"):
        if by_kind[kind]:
            show_single(kind, by_kind[kind])
    if by_kind["clean"]:
        alarms = [row for row in by_kind["clean"] if row["verdict"] != "nothing_found"]
        print(
            f"clean: {len(by_kind['clean'])} sessions, false alarm in {share(len(alarms), len(by_kind['clean']))}"
        )
    if by_kind["pair"]:
        both = sum(has_found_all(row) for row in by_kind["pair"])
        print(f"pair: {len(by_kind['pair'])} sessions, both found in {share(both, len(by_kind['pair']))}")
        show_coverage(by_kind["pair"])
    if iron := by_kind["iron"]:
        holds = sum(any(truth_of(row) in names for names in credible_sets(row)) for row in iron)
        print(
            f"iron: {len(iron)} sessions, truth in the credible set of a cause in {share(holds, len(iron))}"
        )
    learnt = [row for row in by_kind["outside"] if row["truth"][0]["label"] in EFFECTS]
    if learnt:
        show_single("outside once, in the library by now", learnt)
    if unknown := [row for row in by_kind["outside"] if row not in learnt]:
        show_outside(unknown)
    if rows:
        seconds = sorted(row["seconds"] for row in rows)
        print(f"time of a diagnosis: median {seconds[len(seconds) // 2]:.1f} s, longest {seconds[-1]:.1f} s")
    print("confusion, truth -> first set of causes")
    confusion = Counter(
        (truth_of(row), named_in(row)) for row in rows if row["kind"] in ("single", "discrete", "outside")
    )
    for (truth, named), number in sorted(confusion.items()):
        print(f"  {truth:24} {named:60} {number}")


def show_single(kind: str, rows: list[Row]) -> None:
    first = [credible_sets(row)[0] if row["causes"] else [] for row in rows]
    truth = [row["truth"][0]["label"] for row in rows]
    holds = sum(t in names for t, names in zip(truth, first, strict=True))
    sizes = [len(names) for names in first if names]
    named = [(t, row) for t, row in zip(truth, rows, strict=True) if row["verdict"] == "named"]
    right = sum(len(row["causes"]) == 1 and credible_sets(row)[0][0] == t for t, row in named)
    print(
        f"{kind}: {len(rows)} sessions, truth in the credible set of the first cause in {share(holds, len(rows))}, mean size of the set "
        f"{sum(sizes) / max(len(sizes), 1):.2f}, right where one cause is named in {share(right, len(named))}; verdicts "
        f"{dict(Counter(row['verdict'] for row in rows))}"
    )
    several = [row for row, names in zip(rows, first, strict=True) if len(names) > 1]
    if several:
        explained = sum(is_explained(row["causes"][0]) for row in several)
        print(
            f"  sets of several causes as the expected log evidence predicts: {share(explained, len(several))}"
        )
    if kind == "single":
        show_sizes(rows)
        show_coverage(rows)


def is_explained(cause: dict[str, Any]) -> bool:
    """Whether every other member had at least a chance of one in a thousand to stay in the credible set: in 300 sessions some do.

    The log evidence of one hypothesis against another scatters by the root of twice its expected value. The answer is no
    where nothing was computed for a member: it was not fitted in full, or is a mistake of the record.
    """
    expected = [alternative.get("expected_log_evidence") for alternative in cause["alternatives"]]
    return all(e is not None and e - LUCKY_SD * math.sqrt(2.0 * e) < math.log(20.0) for e in expected)


def show_sizes(rows: list[Row]) -> None:
    """Sessions with one right cause: coverage of true sizes, error on unseen readings over the noise, and the coil's parameters."""
    inside = []
    ratio, coils = [], []
    for row in rows:
        sets = credible_sets(row)
        if len(sets) != 1 or sets[0][0] != truth_of(row):
            continue
        sized = row["causes"][0]["parameters"]
        for key, value in true_quantities(row["truth"][0]).items():
            if key in sized:
                low, high = sized[key]["ci90"]
                inside.append(low <= value <= high)
        if row["gain"]:
            ratio.append((row["gain"]["after"]["vector_T"] / noise_T(row)) ** 2)
        coils.append([in_sd(numbers) for numbers in row["coil"].values()])
    if inside:
        print(f"  true sizes inside their 90 % intervals: {share(sum(inside), len(inside))}")
        print(
            f"  error on unseen readings over the noise, rms over sessions: {math.sqrt(sum(ratio) / len(ratio)):.3f}"
        )
        show_coils(coils)


def in_sd(numbers: dict[str, float]) -> tuple[float, float, float]:
    """Error of a coil parameter before and after the extension and without the flaw, in standard deviations of the fit before."""
    before, after, unflawed = (
        (numbers[k] - numbers["truth"]) / numbers["sd_before"] for k in ("before", "after", "unflawed")
    )
    return before, after, unflawed


def show_coils(coils: list[list[tuple[float, float, float]]]) -> None:
    """How often the extension, or a fit without the flaw, is closer to the true coil, by the distance that the flaw had moved it."""
    for least_sd in (1.0, 2.0, 3.0, 4.0):
        biased = [c for c in coils if max(abs(before - unflawed) for before, _, unflawed in c) > least_sd]
        norms = [tuple(math.hypot(*errors) for errors in zip(*c, strict=True)) for c in biased]
        closer = sum(after < before for before, after, _ in norms)
        at_best = sum(unflawed < before for before, _, unflawed in norms)
        print(
            f"  coil closer to the truth, of those that the flaw had moved by more than {least_sd:g} sd: {share(closer, len(biased))}; "
            f"a fit of the same readings without the flaw is closer in {share(at_best, len(biased))}"
        )


def show_coverage(rows: list[Row]) -> None:
    """Coverage of the coil's true parameters by the 90 % intervals of the extended rig."""
    parameters = [numbers for row in rows for numbers in row["coil"].values() if "sd_after" in numbers]
    inside = sum(abs(p["after"] - p["truth"]) < HALF_WIDTH_90 * p["sd_after"] for p in parameters)
    print(f"  the coil's true parameters inside their 90 % intervals: {share(inside, len(parameters))}")


def show_outside(rows: list[Row]) -> None:
    unexplained = sum(row["verdict"] == "unexplained" for row in rows)
    wrong = sum(bool(row["causes"]) and row["verdict"] != "unexplained" for row in rows)
    print(
        f"outside the library: {len(rows)} sessions, unexplained in {share(unexplained, len(rows))}, a wrong name in "
        f"{share(wrong, len(rows))}"
    )
    show_coverage(rows)


def has_found_all(row: Row) -> bool:
    """Whether every true cause is in a credible set of its own."""
    sets, true = credible_sets(row), [cause["label"] for cause in row["truth"]]
    return any(
        all(name in names for name, names in zip(true, chosen, strict=True))
        for chosen in permutations(sets, len(true))
    )


def named_in(row: Row) -> str:
    names = " or ".join(credible_sets(row)[0]) if row["causes"] else "-"
    return f"{row['verdict']}: {names}"


if __name__ == "__main__":
    main()
