"""Every statement that can be judged by machine, held against the truth; `make truthful` runs it.

Each session is calibrated and diagnosed by the command line, as a user would. A judge that knows what is hidden in it reads what was
printed, and asks the models that were handed out, from their files. Sessions are made by independent code; of a measured map, held-out
readings tell the truth. Rows are appended to a file as sessions end, and their folders are kept, so an interrupted study continues.
Target: no false statement in a thousand.
"""

from __future__ import annotations

import argparse
import os
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

from scripts.studies.hidden_cases import Row, rows_of, share_and_interval
from scripts.studies.judge import of_calibration, of_diagnosis
from scripts.studies.judge.case import Case
from scripts.studies.judge.intervals import missed_90
from scripts.studies.judge.sessions import KINDS, MAP, MAPS, prepared
from scripts.studies.judge.statements import CONDITION, Statement

FIRST_SEED = 470_000
IN_A_THOUSAND = 1000
LAST_DIGITS = 0.02  # of a number: what is off by less differs in its last digits only
WIDTH = 260  # of a printed statement


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--cases", type=int, default=100, help="number of hidden sessions, of all kinds in turn"
    )
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument(
        "--maps", default=",".join(MAPS), help="measured maps, where COILCAL_DATA names their folder"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("out/truthful.jsonl"))
    parser.add_argument("--again", action="store_true", help="judge all kept folders once more")
    options = parser.parse_args()
    if options.again:
        options.out.unlink(missing_ok=True)
    kinds = options.kinds.split(",")
    cases = [(kinds[i % len(kinds)], options.first_seed + i) for i in range(options.cases)]
    if os.environ.get("COILCAL_DATA"):
        cases += [(MAP, list(MAPS).index(name)) for name in filter(None, options.maps.split(","))]
    run = partial(run_case, options.out.with_suffix(""))
    show(rows_of(cases, run, options.out, options.workers, line))


def run_case(work: Path, kind: str, seed: int) -> Row:
    """One session, from its readings to the judgement of all that was printed of it."""
    began = time.perf_counter()
    name = list(MAPS)[seed] if kind == MAP else str(seed)
    case, statements = prepared(kind, seed, work.resolve() / f"{kind}-{name}")
    row: Row = {"kind": kind, "seed": seed, "name": name}
    row["hidden"] = "a measured map" if case.truth is None else case.truth.words
    if statements:
        return row | {"statements": [each.to_json() for each in statements], "unread": []}
    statements, unread = judged(case)
    return row | {
        "verdicts": [case.summary["quality"]["verdict"], case.diagnosis["verdict"]],
        "statements": [each.to_json() for each in statements],
        "unread": unread,
        "missed_90": _missed(case),
        "seconds": time.perf_counter() - began,
    }


def judged(case: Case) -> tuple[list[Statement], list[str]]:
    """All statements of a case, and the shapes of lines that nobody judges."""
    of_calibrate, unread_there = of_calibration.judged(case)
    of_diagnose, unread_here = of_diagnosis.judged(case)
    return [*of_calibrate, *of_diagnose], [*unread_there, *unread_here]


def _missed(case: Case) -> dict[str, Any]:
    """By command, how many 90 % intervals of numbers of the rig miss the truth, and their number."""
    models = {"calibrate": case.plain, "diagnose": case.extended}
    if case.truth is None:
        return {}
    return {name: missed_90(model, case.truth) for name, model in models.items() if model is not None}


# ---------------------------------------------------------------------------------------------------------------- what is printed


def line(row: Row) -> str:
    """One session in a line."""
    if "error" in row:
        return f"{row['kind']} {row['seed']}: {row['error']}"
    false = [each for each in row["statements"] if is_false(each)]
    verdicts = ", ".join(row.get("verdicts", ["not judged"]))
    return f"{row['kind']} {row['name']}: {row['hidden']} -> {verdicts}: {len(false)} of {len(row['statements'])} false"


def is_false(statement: Row) -> bool:
    """Whether a statement that is judged by itself is not so."""
    return not statement["is_true"] and "aside" not in statement


def show(rows: list[Row]) -> None:
    for row in rows:
        if "error" in row:
            print(f"not judged: {line(row)}")
    rows = [row for row in rows if "error" not in row]
    pairs = [(row, each) for row in rows for each in row["statements"]]
    judged_alone = [(row, each) for row, each in pairs if "aside" not in each]
    false = [(row, each) for row, each in judged_alone if not each["is_true"]]
    print(f"{len(rows)} sessions, {len(judged_alone)} statements judged, {len(false)} false")
    if judged_alone:
        print(f"in a thousand: {IN_A_THOUSAND * len(false) / len(judged_alone):.1f}; target: none")
    total = Counter(each["kind"] for _, each in judged_alone)
    by_kind = Counter(each["kind"] for _, each in false)
    in_digits = Counter(each["kind"] for _, each in false if each.get("off", 1.0) < LAST_DIGITS)
    for kind, number in sorted(total.items(), key=lambda item: (-by_kind[item[0]], item[0])):
        last = f", {in_digits[kind]} of these in the last digits" if in_digits[kind] else ""
        print(f"  {kind:20} {by_kind[kind]:5} of {number} false{last}")
    show_probabilities(rows)
    show_intervals(rows)
    show_statements(false)
    conditional = [(row, each) for row, each in pairs if each.get("aside") == CONDITION]
    if conditional:
        not_so = [(row, each) for row, each in conditional if not each["is_true"]]
        print(
            f"\nunder conditions that do not hold: {len(conditional)} statements, {len(not_so)} would be false without them"
        )
        show_statements(not_so)
    unread = Counter(shape for row in rows for shape in row["unread"])
    if unread:
        print(f"\nlines that nobody judges: {sum(unread.values())}, of {len(unread)} shapes")
        for shape, number in unread.most_common(30):
            print(f"  {number:4} {shape[:WIDTH]}")


def show_statements(pairs: list[tuple[Row, Row]]) -> None:
    """Statements with the truth, by kind, the most frequent kind first."""
    for kind, _ in Counter(each["kind"] for _, each in pairs).most_common():
        print(f"\n{kind}:")
        for row, each in pairs:
            if each["kind"] == kind:
                print(
                    f"  {row['kind']} {row['name']}, {each['source']}: {each['text'][:WIDTH]}\n    truth: {each['why'][:WIDTH]}"
                )


def show_probabilities(rows: list[Row]) -> None:
    """How many statements that are made with a probability are true, beside the number that these probabilities promise."""
    stated = [each for row in rows for each in row["statements"] if "stated" in each]
    for kind in sorted({each["kind"] for each in stated}):
        own = [each for each in stated if each["kind"] == kind]
        expected = sum(each["stated"] for each in own)
        print(
            f"  {kind}: {sum(each['is_true'] for each in own)} of {len(own)} stated with a probability are true, {expected:.1f} expected"
        )


def show_intervals(rows: list[Row]) -> None:
    """How many 90 % intervals hold the truth, by command and verdict, over all sessions."""
    for number, command in enumerate(("calibrate", "diagnose")):
        held: Counter[str] = Counter()
        total: Counter[str] = Counter()
        for row in rows:
            missed, n = row.get("missed_90", {}).get(command, (0, 0))
            if n:
                held[row["verdicts"][number]] += n - missed
                total[row["verdicts"][number]] += n
        for verdict, n in sorted(total.items()):
            print(
                f"  90 % intervals of {command}, {verdict}: {share_and_interval(held[verdict], n)} hold the truth"
            )


if __name__ == "__main__":
    main()
