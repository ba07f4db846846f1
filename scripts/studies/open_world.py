"""Diagnoses of sessions whose cause may be in the library or not, at natural sizes; `make open-world` runs it.

Every case is appended to a file as it ends, so an interrupted study continues. It prints shares of verdicts, lone wrong names, false
alarms, how often stated probabilities are right (with a diagram beside the rows), and proper scores.
"""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise
from pathlib import Path
from statistics import fmean, median
from typing import NamedTuple

from matplotlib.axes import Axes
from scipy.stats import binomtest

from estimator.effects import EFFECTS
from estimator.reporting.plots.style import BLUE, GREY, axes, styled
from scripts.studies.hidden_cases import (
    Row,
    diagnosed,
    gather,
    noise_T,
    options_of,
    row_of,
    share,
    share_and_interval,
)
from scripts.studies.imitation import left_of_truth
from tests.hidden.study import OPEN_KINDS, draw_case, is_relative

ABSENT = "not in the library"
ANOTHER = "another of the library"
LEAST_OF_A_SET = 0.05  # a 95 % credible set names what is as probable as this
LEAST_SCORED = 1e-3  # probabilities below count as this: reports state no smaller ones
NEAR_SIGMA = 5.0  # of a truth without noise that the named causes leave: too little to be told from it
NEAR_NOISE = 1.1  # error on unseen readings over the noise up to which a model is as good as the readings
NEAR_90 = 0.05  # of a 90 % interval's coverage
EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0)
THRESHOLDS = (0.5, 0.8, 0.95)


class Statement(NamedTuple):
    """A probability that was stated, of a name or of none in the library, and whether it came true."""

    probability: float
    is_right: bool


def main() -> None:
    options = options_of(__doc__, OPEN_KINDS, 100, 50_000, "out/open_world.jsonl").parse_args()
    rows = gather(options, run_case)
    show(rows)
    diagram = options.out.with_suffix(".png")
    save_diagram(statements(rows), diagram)
    print(f"reliability diagram: {diagram}")


def run_case(kind: str, seed: int) -> Row:
    """Hide a cause, or none, and diagnose."""
    hidden = draw_case(kind, seed, EFFECTS)
    diagnosis, seconds = diagnosed(hidden, seed)
    row = row_of(kind, hidden, diagnosis, seconds) | {"left_of_truth": left_of_truth(hidden, diagnosis)}
    for cause in row["truth"]:
        cause["is_known"] = cause["name"] in EFFECTS
    return row


# ------------------------------------------------------------------------------------------------------------- what a row says


def stated(cause: Row) -> dict[str, float]:
    """Probability by name, without places, that a diagnosis gives to what one of its causes is; the rest is another of the library."""
    probabilities: Counter[str] = Counter()
    for one in (cause, *cause["alternatives"]):
        probabilities[one["name"].partition("[")[0]] += one["probability"]
    probabilities[ABSENT] += cause.get("p_not_in_library") or 0.0
    return dict(probabilities)


def lone_name(cause: Row) -> str | None:
    """The name of a cause that is stated alone: neither another nor something unknown is in its credible set."""
    probabilities = stated(cause)
    if probabilities.pop(ABSENT) >= LEAST_OF_A_SET or len(probabilities) > 1:
        return None
    return next(iter(probabilities))


def lone_names(row: Row) -> tuple[list[str], list[str], list[str]]:
    """Names stated alone: right ones, relatives of the truth, wrong ones."""
    truths = [cause["label"] for cause in row["truth"]]
    names = [name for name in map(lone_name, row["causes"]) if name is not None]
    right = [name for name in names if name in truths]
    relatives = [n for n in names if n not in right and any(is_relative(n, truth) for truth in truths)]
    return right, relatives, [n for n in names if n not in right and n not in relatives]


def is_named_wrongly(row: Row) -> bool:
    """Whether the verdict is `named` and a name is not that of a hidden cause, as a sceptic counts; whatever probability is left aside."""
    truths = [cause["label"] for cause in row["truth"]]
    names = [cause["name"].partition("[")[0] for cause in row["causes"]]
    return row["verdict"] == "named" and any(name not in truths for name in names)


def is_refutable(row: Row) -> bool:
    """Whether readings could tell the causes that were found from the hidden ones, by a fit of them to readings without noise."""
    return bool(row["left_of_truth"] >= NEAR_SIGMA)


def prediction(row: Row) -> dict[str, float] | None:
    """What a row states of the one hidden cause, from the first cause of its verdict; None where it found nothing to speak of."""
    if row["verdict"] == "nothing_found":
        return None
    absent = row.get("p_not_in_library")
    if not row["causes"]:  # `unexplained` without a name says that it is none of the library
        absent = 1.0 if absent is None else absent
        return {ABSENT: absent, ANOTHER: 1.0 - absent}
    probabilities = stated(row["causes"][0])
    return probabilities | {ANOTHER: max(0.0, 1.0 - sum(probabilities.values()))}


def outcome(row: Row, named: dict[str, float]) -> str:
    """Which of the possibilities of a prediction is true."""
    truth = row["truth"][0]
    if not truth["is_known"]:
        return ABSENT
    return str(truth["label"]) if truth["label"] in named else ANOTHER


def statements(rows: list[Row]) -> list[Statement]:
    """Every stated probability of a name in the mixture of kind `open`."""
    return [
        Statement(p, name in [cause["label"] for cause in row["truth"]])
        for row in rows
        if row["kind"] == "open"
        for cause in row["causes"]
        for name, p in stated(cause).items()
        if name != ABSENT
    ]


# ---------------------------------------------------------------------------------------------------------------- what is printed


def show(rows: list[Row]) -> None:
    for kind in OPEN_KINDS:
        mine = [row for row in rows if row["kind"] == kind]
        if mine:
            show_kind(kind, mine)
    mixture = [row for row in rows if row["kind"] == "open"]
    if mixture:
        show_reliability(statements(mixture))
        show_scores(mixture)
    seconds = sorted(row["seconds"] for row in rows)
    if seconds:
        print(f"time of a diagnosis: median {seconds[len(seconds) // 2]:.1f} s, longest {seconds[-1]:.1f} s")
    confusion = Counter((row["truth"][0]["label"], _short(row)) for row in rows if row["truth"])
    print("confusion, truth -> verdict and names")
    for (truth, named), number in sorted(confusion.items()):
        print(f"  {truth:24} {named:60} {number}")


def show_kind(kind: str, rows: list[Row]) -> None:
    n = len(rows)
    verdicts = Counter(row["verdict"] for row in rows)
    print(f"{kind}: {n} sessions")
    for verdict, count in verdicts.most_common():
        print(f"  {verdict:20} {share_and_interval(count, n)}")
    if kind.startswith("clean"):
        print(f"  false alarm          {share_and_interval(n - verdicts['nothing_found'], n)}")
        return
    lone = [lone_names(row) for row in rows]
    for words, place in (("lone name right", 0), ("lone relative", 1), ("lone wrong name", 2)):
        print(f"  {words:20} {share_and_interval(sum(bool(one[place]) for one in lone), n)}")
    strict = sum(is_named_wrongly(row) for row in rows)
    print(f"  named, not the truth {share_and_interval(strict, n)}")
    refutable = sum(is_named_wrongly(row) and is_refutable(row) for row in rows)
    print(f"  of these a name that readings could refute {share_and_interval(refutable, n)}")
    show_unseen([row for row in rows if row["gain"]])


def show_unseen(rows: list[Row]) -> None:
    """Errors on unseen readings over the noise, and what corrections did to them."""
    if not rows:
        return
    errors = {
        when: [row["gain"][when]["vector_T"] / noise_T(row) for row in rows] for when in ("before", "after")
    }
    corrected = [row for row in rows if row["correction"] and not row["correction"]["refusal"]]
    print(
        f"  error on unseen readings over the noise, median: {median(errors['before']):.2f} before, {median(errors['after']):.2f} after"
    )
    within = sum(error <= NEAR_NOISE for error in errors["after"])
    print(f"  within {NEAR_NOISE} of the noise after: {share_and_interval(within, len(rows))}")
    print(f"  corrected            {share_and_interval(len(corrected), len(rows))}")
    judged = [row for row in corrected if row["correction"]["gain"]]
    if not judged:
        return
    gains = [row["correction"]["gain"] for row in judged]
    ratios = [gain["with_correction"]["vector_T"] / gain["with_causes"]["vector_T"] for gain in gains]
    print(
        f"  their error on unseen readings, with the correction over without: median {median(ratios):.2f}, largest {max(ratios):.2f}"
    )
    for protocol in sorted({row["protocol"] for row in judged}):
        mine = [row["correction"]["gain"] for row in judged if row["protocol"] == protocol]
        held = [[gain[model]["coverage90"] for gain in mine] for model in ("with_causes", "with_correction")]
        n_near = sum(abs(share - 0.9) <= NEAR_90 for share in held[1])
        print(
            f"  unseen readings inside their 90 % intervals, protocol {protocol}: {fmean(held[0]):.1%} without the correction, "
            f"{fmean(held[1]):.1%} with it; {n_near} of {len(mine)} sessions within {NEAR_90:.0%} of it"
        )


def show_reliability(stated_ones: list[Statement], kind: str = "open") -> None:
    print(f"stated probability of a name -> share of names that are right (kind {kind})")
    for low, high, mine in _binned(stated_ones):
        mean = sum(p for p, _ in mine) / len(mine)
        right = sum(is_right for _, is_right in mine)
        print(f"  {low:4.0%} to {high:4.0%}, mean {mean:6.1%}: {share_and_interval(right, len(mine))}")
    for threshold in THRESHOLDS:
        mine = [one for one in stated_ones if one.probability >= threshold]
        right, mean = sum(one.is_right for one in mine), sum(p for p, _ in mine) / max(len(mine), 1)
        print(f"  at least {threshold:.0%}, mean {mean:6.1%}: {share_and_interval(right, len(mine))}")


def show_scores(rows: list[Row]) -> None:
    """Log and Brier score of what was stated; both are 0 where the truth is certain, and smaller is better."""
    pairs = [(named, outcome(row, named)) for row in rows if (named := prediction(row)) is not None]
    logs = [-math.log(max(named[truth], LEAST_SCORED)) for named, truth in pairs]
    briers = [sum((p - (name == truth)) ** 2 for name, p in named.items()) for named, truth in pairs]
    absent = [row for row in rows if not row["truth"][0]["is_known"]]
    print(
        f"something was said in {share(len(pairs), len(rows))}; {share(len(absent), len(rows))} hold a cause outside the library"
    )
    if pairs:
        log, brier = sum(logs) / len(pairs), sum(briers) / len(pairs)
        print(f"  scores of what was said: log {log:.3f} nats, Brier {brier:.3f}")
        mean, right = (
            sum(named[ABSENT] for named, _ in pairs) / len(pairs),
            sum(t == ABSENT for _, t in pairs),
        )
        print(f"  {ABSENT}: stated {mean:.1%} in the mean, true in {share_and_interval(right, len(pairs))}")


@styled
def plot_reliability(stated_ones: list[Statement], ax: Axes | None = None) -> Axes:
    """Share of names that are right against the probability that was stated, with exact 95 % intervals."""
    ax = axes(ax, 4.2, 4.0)
    ax.plot((0.0, 1.0), (0.0, 1.0), color=GREY, linewidth=1.0, label="calibrated")
    for _, _, mine in _binned(stated_ones):
        right, mean = sum(one.is_right for one in mine), sum(p for p, _ in mine) / len(mine)
        ends = binomtest(right, len(mine)).proportion_ci(0.95, "exact")
        ax.plot((mean, mean), (ends.low, ends.high), color=BLUE, linewidth=1.5)
        ax.plot(mean, right / len(mine), "o", color=BLUE)
        ax.annotate(f" {len(mine)}", (mean, right / len(mine)))
    ax.set(
        xlabel="stated probability of a name",
        ylabel="share of names that are right",
        xlim=(0, 1),
        ylim=(0, 1),
    )
    ax.set_title(f"{len(stated_ones)} names; number per point, 95 % intervals")
    ax.legend(loc="upper left")
    return ax


def save_diagram(stated_ones: list[Statement], path: Path) -> None:
    plot_reliability(stated_ones).figure.savefig(path, dpi=150)


def _binned(stated_ones: list[Statement]) -> list[tuple[float, float, list[Statement]]]:
    """Statements by bin of probability, without empty bins; 1 belongs to the last."""
    bins = [
        (
            low,
            high,
            [one for one in stated_ones if low <= one.probability < high or one.probability == high == 1.0],
        )
        for low, high in pairwise(EDGES)
    ]
    return [one for one in bins if one[2]]


def _short(row: Row) -> str:
    names = " + ".join(" or ".join(n for n in stated(cause) if n != ABSENT) for cause in row["causes"])
    return f"{row['verdict']}: {names or '-'}"


if __name__ == "__main__":
    main()
