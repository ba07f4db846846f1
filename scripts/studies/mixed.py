"""Diagnoses of sessions with one or two causes of the list and one beside them that no list holds; run it as a module.

Every case is appended to a file as it ends, so an interrupted study continues, and a row keeps nearly all that the diagnosis writes: later
engines are compared on the same sessions. It prints which listed causes were stated, which names are not there, how often intervals
hold the truth, and the link of the unlisted cause where a diagnosis tells of links.
"""

from __future__ import annotations

from collections import Counter
from statistics import fmean, median
from typing import Any

from estimator import Diagnosis
from estimator.readings.metrics import HALF_WIDTH_90
from scripts.studies.hidden_cases import (
    Row,
    diagnosed,
    gather,
    noise_T,
    options_of,
    row_of,
    share_and_interval,
)
from scripts.studies.mixed_counts import (
    MODELS,
    SIZES,
    STATED,
    coil_inside,
    families_right,
    is_stated,
    is_stated_alone,
    is_taken,
    judged,
    link_of_correction,
    link_told,
    listed,
    p_of_its_links,
    p_unlisted,
    probabilities,
    sizes_inside,
    tells_of_unlisted,
    unlisted,
)
from scripts.studies.open_world import NEAR_NOISE, is_named_wrongly, show_reliability
from tests.hidden.handed_in import HiddenSession
from tests.hidden.links import LISTED, links_of
from tests.hidden.study import MIXED_KINDS, draw_case

TOLD = 0.5  # probability of a link from which on it counts as told
NOT_KEPT = ("smallest_visible",)  # long, and about causes that are not there


def main() -> None:
    show(gather(options_of(__doc__, MIXED_KINDS[:1], 100, 550_000, "out/mixed.jsonl").parse_args(), run_case))


def run_case(kind: str, seed: int) -> Row:
    """Hide a mixture and diagnose."""
    hidden = draw_case(kind, seed)
    diagnosis, seconds = diagnosed(hidden, seed)
    told, row = diagnosis.to_json(), row_of(kind, hidden, diagnosis, seconds)
    sensors = [sensor.name for sensor in hidden.schedule.sensors]
    for cause in row["truth"]:
        cause["is_listed"] = cause["name"] in LISTED
        cause["links"] = list(links_of(cause["name"], len(sensors)))
    return row | {
        "sensors": sensors,
        "links": (told["mixture"] or {}).get("unlisted"),
        "coil": coil_numbers(hidden, diagnosis),
        "told": {key: value for key, value in told.items() if key not in row and key not in NOT_KEPT},
    }


def coil_numbers(hidden: HiddenSession, diagnosis: Diagnosis) -> dict[str, dict[str, Any]]:
    """True numbers of the coil, with 90 % intervals without extension, with it, and widened by what is left."""
    told, plain = diagnosis.to_json(), diagnosis.fits.plain
    numbers = {}
    for name, truth in hidden.truth()["values"].items():
        extended = told["rig_parameters"].get(name)
        if extended is None or not name.startswith("coil1.") or name not in plain.values:
            continue
        middle, half = float(plain.values[name]), HALF_WIDTH_90 * plain.value_sd(name)
        factor = told["widening"].get(name, 1.0)
        numbers[name] = {
            "truth": truth,
            "plain": [middle - half, middle + half],
            "extended": extended["ci90"],
            "widened": [extended["median"] + factor * (end - extended["median"]) for end in extended["ci90"]],
        }
    return numbers


# ---------------------------------------------------------------------------------------------------------------- what is printed


def show(rows: list[Row]) -> None:
    if not rows:
        return
    print(f"{len(rows)} mixed sessions")
    for verdict, count in Counter(row["verdict"] for row in rows).most_common():
        print(f"  {verdict:20} {share_and_interval(count, len(rows))}")
    show_stated(rows)
    show_names(rows)
    show_intervals(rows)
    show_reliability([one for row in rows for one in probabilities(row)], "mixed")
    show_unlisted(rows)
    show_unseen(rows)
    seconds = sorted(row["seconds"] for row in rows)
    print(f"time of a diagnosis: median {median(seconds):.1f} s, longest {seconds[-1]:.1f} s")


def show_stated(rows: list[Row]) -> None:
    """Listed causes that were stated, by visible size."""
    pairs = [(row, truth) for row in rows for truth in listed(row)]
    for low, high in ((0.0, float("inf")), *SIZES):
        mine = [(row, truth) for row, truth in pairs if low <= truth["visible_sigma"] < high]
        words = f"listed causes of {low:g} to {high:g} sigma" if low else "listed causes"
        alone = sum(is_stated_alone(row, truth) for row, truth in mine)
        print(
            f"{words}: stated {share_and_interval(sum(is_stated(r, t) for r, t in mine), len(mine))}, alone {alone}"
        )
    every = sum(all(is_stated(row, truth) for truth in listed(row)) for row in rows)
    taken = sum(is_taken(row, truth) for row, truth in pairs)
    print(
        f"listed causes in any set of the verdict, or in the rig unnamed: {share_and_interval(taken, len(pairs))}"
    )
    print(f"sessions whose listed causes are all stated: {share_and_interval(every, len(rows))}")


def show_names(rows: list[Row]) -> None:
    """Sets of names by what they are worth: stated ones, and all of the verdicts whatever their probability."""
    for words, least in (("statements of a listed cause", STATED), ("sets of names at any probability", 0.0)):
        counts = [judged(row, least) for row in rows]
        right, relative, wrong, like = (sum(numbers) for numbers in zip(*counts, strict=True))
        total = right + relative + wrong
        print(f"{words}: {total}")
        for kind, count in (("right", right), ("relative of a listed one", relative), ("not there", wrong)):
            print(f"  {kind:24} {share_and_interval(count, total)}")
        print(f"  of those not there, {like} are relatives of the unlisted cause")
        sessions = sum(one.wrong > 0 for one in counts)
        print(f"  sessions with a name that is not there: {share_and_interval(sessions, len(rows))}")
    families = [is_right for row in rows for is_right in families_right(row)]
    print(
        f"families of causes stated, at a link where something acts: {share_and_interval(sum(families), len(families))}"
    )
    named = [row for row in rows if row["verdict"] == "named"]
    wrong = sum(is_named_wrongly(row) for row in named)
    print(f"verdicts `named` with a name that is not there: {share_and_interval(wrong, len(named))}")


def show_intervals(rows: list[Row]) -> None:
    """Coverage of 90 % intervals."""
    sizes = [is_in for row in rows for is_in in sizes_inside(row)]
    print(f"true sizes inside their 90 % intervals: {share_and_interval(sum(sizes), len(sizes))}")
    for model in MODELS:
        inside = [is_in for row in rows for is_in in coil_inside(row, model)]
        print(
            f"the coil's true numbers inside their 90 % intervals, {model}: {share_and_interval(sum(inside), len(inside))}"
        )


def show_unlisted(rows: list[Row]) -> None:
    """What is told of the unlisted cause."""
    told = sum(tells_of_unlisted(row) for row in rows)
    print(f"something unlisted is told: {share_and_interval(told, len(rows))}")
    print(f"  its probability, mean: {fmean(p_unlisted(row) for row in rows):.2f}")
    corrections = [(row, link) for row in rows if (link := link_of_correction(row)) is not None]
    near = sum(link in unlisted(row)["links"] for row, link in corrections)
    print(f"  strongest correction sits in its link: {share_and_interval(near, len(corrections))}")
    with_links = [row for row in rows if row["links"] and max(row["links"].values()) >= TOLD]
    if not with_links:
        print(f"  no diagnosis tells of a link with {TOLD:.0%} or more")
        return
    right = sum(link_told(row) in unlisted(row)["links"] for row in with_links)
    print(
        f"  most probable link right where it has {TOLD:.0%} or more: {share_and_interval(right, len(with_links))}"
    )
    print(f"  probability of its links, mean: {fmean(p_of_its_links(row) for row in with_links):.2f}")


def show_unseen(rows: list[Row]) -> None:
    """Errors on unseen readings over the noise."""
    judged_rows = [row for row in rows if row["gain"]]
    for when in ("before", "after"):
        errors = [row["gain"][when]["vector_T"] / noise_T(row) for row in judged_rows]
        if errors:
            near = share_and_interval(sum(error <= NEAR_NOISE for error in errors), len(errors))
            print(
                f"error on unseen readings over the noise, {when}: median {median(errors):.2f}, within {NEAR_NOISE} in {near}"
            )
    corrected = [
        row["correction"]["gain"]["with_correction"]["vector_T"] / noise_T(row)
        for row in judged_rows
        if row["correction"] and not row["correction"]["refusal"] and row["correction"]["gain"]
    ]
    if corrected:
        print(
            f"  of {len(corrected)} that were corrected, with the correction: median {median(corrected):.2f}"
        )


if __name__ == "__main__":
    main()
