"""Each cause in turn is taken out of the library, hidden by independent code, and diagnosed; `make leave-one-out` runs it.

So every cause that coilcal knows is an unknown one for once. Every case is appended to a file as it ends, so an interrupted study
continues. The table is Markdown.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from estimator.effects import EFFECTS, ORDER
from scripts.studies.hidden_cases import (
    Row,
    diagnosed,
    gather,
    noise_T,
    options_of,
    row_of,
    share_and_interval,
)
from scripts.studies.imitation import left_of_truth
from scripts.studies.open_world import ABSENT, LEAST_OF_A_SET, NEAR_SIGMA, is_refutable, lone_name, stated
from tests.hidden.library import ALL
from tests.hidden.open_session import adjustable_of, draw_open_session
from tests.hidden.rivals import left_beside

STREAM = 994
HEADS = (
    "cause left out",
    "n",
    "best imitation, sigma left",
    "mark",
    "says unknown",
    "lone wrong",
    "nothing found",
    "names given",
    "error on unseen readings over the noise",
)
NO_TWIN, EXACT_TWIN, NEAR_TWIN = "", "exact twin", "near twin"
EXACT_SIGMA = 1.0  # of a hidden cause that another leaves: nothing to see


def main() -> None:
    hideable = [name for name in EFFECTS if name in ALL and ALL[name].has_size]
    parser = options_of(__doc__, hideable, 8, 60_000, "out/leave_one_out.jsonl")
    parser.add_argument(
        "--sigma", type=float, default=30.0, help="visible size; rows of each size need a file of their own"
    )
    options = parser.parse_args()
    show(gather(options, partial(run_case, sigma=options.sigma)))


def run_case(name: str, seed: int, sigma: float) -> Row:
    """Hide a cause, and diagnose without it in the library."""
    hidden = draw_open_session(
        [STREAM, *name.encode()], lambda possible: [name] if name in possible else [], sigma, seed
    )
    with without(name):
        diagnosis, seconds = diagnosed(hidden, seed)
        row = row_of(name, hidden, diagnosis, seconds) | {"left_of_truth": left_of_truth(hidden, diagnosis)}
    assert hidden.rig is not None
    left = left_beside(adjustable_of(hidden.rig, hidden.scene), hidden.flaws[0], EFFECTS)
    return row | {
        "sigma": sigma,
        "left_beside": {n: s for n, s in left.items() if s < NEAR_SIGMA or n == next(iter(left))},
    }


@contextmanager
def without(name: str) -> Iterator[None]:
    """The library of this process lacks a cause."""
    saved = [(table, dict(table)) for table in (EFFECTS, ORDER)]
    for table, _ in saved:
        table.pop(name)
    try:
        yield
    finally:  # in the old order, which counts
        for table, whole in saved:
            table.clear()
            table.update(whole)


def mark(row: Row) -> str:
    """Whether the readings could tell the hidden cause from the best imitation by another one, as a computation says."""
    left = min(row["left_beside"].values())
    return EXACT_TWIN if left < EXACT_SIGMA else NEAR_TWIN if left < NEAR_SIGMA else NO_TWIN


def says_unknown(row: Row) -> bool:
    """`unexplained`, or a credible set that holds something which is not in the library."""
    return row["verdict"] == "unexplained" or any(
        p >= LEAST_OF_A_SET
        for p in ((row.get("p_not_in_library") or 0.0), *(stated(c)[ABSENT] for c in row["causes"]))
    )


def wrong_names(row: Row) -> list[str]:
    """Names stated alone, all wrong by construction, but for twins of the hidden cause as the linear imitation tells them."""
    twins = {name for name, left in row["left_beside"].items() if left < NEAR_SIGMA}
    return [name for name in map(lone_name, row["causes"]) if name is not None and name not in twins]


def show(rows: list[Row]) -> None:
    """The table, and the shares over all causes that are no twins of another."""
    print(f"| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
    for name in dict.fromkeys(row["kind"] for row in rows):
        print(table_line(name, [row for row in rows if row["kind"] == name]))
    apart = [row for row in rows if mark(row) == NO_TWIN]
    print(
        f"\n{len(rows)} sessions, {len(apart)} of them without a twin in the rest of the library; of these:"
    )
    for words, count in (
        ("unexplained or a set with something not in the library", sum(map(says_unknown, apart))),
        ("a lone wrong name", sum(bool(wrong_names(row)) for row in apart)),
        (
            "of these one that readings could refute",
            sum(bool(wrong_names(row)) and is_refutable(row) for row in apart),
        ),
        ("nothing found", sum(row["verdict"] == "nothing_found" for row in apart)),
        (
            "of these with something to find",
            sum(row["verdict"] == "nothing_found" and is_refutable(row) for row in apart),
        ),
    ):
        print(f"- {words}: {share_and_interval(count, len(apart))}")


def table_line(name: str, rows: list[Row]) -> str:
    """One cause."""
    imitations = sorted(
        (min(r["left_beside"].items(), key=lambda item: item[1]) for r in rows), key=lambda item: item[1]
    )
    best, left = imitations[len(imitations) // 2]
    marks = " ".join(f"{word} {n}" for word, n in Counter(map(mark, rows)).items() if word != NO_TWIN)
    given = Counter(" or ".join(n for n in stated(c) if n != ABSENT) for r in rows for c in r["causes"])
    names = ", ".join(f"{one} {n}" for one, n in given.most_common()) or "none"
    errors = [
        sorted(row["gain"][when]["vector_T"] / noise_T(row) for row in rows if row["gain"])
        for when in ("before", "after")
    ]
    unseen = " to ".join(f"{e[len(e) // 2]:.2f}" if e else "-" for e in errors)
    counts = (
        sum(map(says_unknown, rows)),
        sum(bool(wrong_names(row)) for row in rows),
        sum(row["verdict"] == "nothing_found" for row in rows),
    )
    cells = [name, len(rows), f"{best}, {left:.1f}", marks, *counts, names, unseen]
    return f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    main()
