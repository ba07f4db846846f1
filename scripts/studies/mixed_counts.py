"""What rows of mixed sessions say: listed causes that were stated, names that are not there, intervals and links. Counts only."""

from __future__ import annotations

from typing import NamedTuple

from scripts.studies.hidden_cases import Row
from scripts.studies.open_world import ABSENT, Statement, stated
from tests.hidden.links import LINK_OF_DEPARTURE
from tests.hidden.study import is_relative, is_same, true_quantities

STATED = 0.9  # probability from which a cause, or a set of causes, counts as stated
SIZES = ((8.0, 15.0), (15.0, 30.0), (30.0, float("inf")))  # visible sizes that are counted apart, in sigma
TOLD = 0.5  # probability from which something unlisted counts as told
MODELS = ("plain", "extended", "widened")
OWN_NUMBERS = (
    "winding_misstated",
    "coil_misplaced",
)  # after these a true number of the coil has two meanings


class Judged(NamedTuple):
    """Statements of a diagnosis by what they are worth; of the wrong ones some name a relative of the unlisted cause."""

    right: int
    relative: int
    wrong: int
    wrong_but_like_the_unlisted: int


def listed(row: Row) -> list[Row]:
    """Hidden causes that the list holds."""
    return [cause for cause in row["truth"] if cause["is_listed"]]


def unlisted(row: Row) -> Row:
    """The hidden cause that no list holds."""
    cause: Row
    (cause,) = (cause for cause in row["truth"] if not cause["is_listed"])
    return cause


def is_stated_alone(row: Row, truth: Row) -> bool:
    """Whether a hidden cause has at least `STATED` by itself."""
    return any(stated(cause).get(truth["label"], 0.0) >= STATED for cause in row["causes"])


def is_stated(row: Row, truth: Row) -> bool:
    """Whether a hidden cause is stated alone or is in a set of causes that together have at least `STATED`."""
    sets = any(is_same(name, truth["label"]) for names in stated_sets(row) for name in names)
    return sets or is_stated_alone(row, truth)


def is_taken(row: Row, truth: Row) -> bool:
    """Whether a hidden cause is in a set of the verdict at all, or stands in the rig unnamed."""
    stand_ins = {cause["name"].partition("[")[0] for cause in row["told"]["stand_ins"]}
    return truth["label"] in stand_ins or any(truth["label"] in stated(cause) for cause in row["causes"])


def stated_sets(row: Row, least: float = STATED) -> list[set[str]]:
    """Names of every cause with its alternatives, where these have a probability together; the rest is something unlisted."""
    sets = []
    for cause in row["causes"]:
        names = stated(cause)
        del names[ABSENT]
        if sum(names.values()) >= least:
            sets.append(set(names))
    return sets


def judged(row: Row, least: float = STATED) -> Judged:
    """Sets of names with a probability together that hold a listed cause, else a declared relative of one, else nothing that is there."""
    truths = {cause["label"] for cause in listed(row)}
    hidden = unlisted(row)["label"]
    right = relative = wrong = like_the_unlisted = 0
    for names in stated_sets(row, least):
        if any(is_same(name, truth) for name in names for truth in truths):
            right += 1
        elif any(is_relative(name, truth) for name in names for truth in truths):
            relative += 1
        else:
            wrong += 1
            like_the_unlisted += any(is_relative(name, hidden) for name in names)
    return Judged(right, relative, wrong, like_the_unlisted)


def probabilities(row: Row) -> list[Statement]:
    """Every probability that was stated of a name, and whether that listed cause is there."""
    truths = {cause["label"] for cause in listed(row)}
    return [
        Statement(p, name in truths)
        for cause in row["causes"]
        for name, p in stated(cause).items()
        if name != ABSENT
    ]


def families_right(row: Row) -> list[bool]:
    """Whether something hidden acts at a link of each family that is stated."""
    links = {link for cause in row["truth"] for link in cause["links"]}
    families = [cause["family"] for cause in row["causes"] if cause.get("family")]
    return [bool(links & set(each["links"])) for each in families if each["probability"] >= STATED]


def sizes_inside(row: Row) -> list[bool]:
    """Whether true quantities of the listed causes that were named first lie in their 90 % intervals."""
    inside = []
    for truth in listed(row):
        for cause in row["causes"]:
            is_elsewhere = truth["place"] in row["sensors"] and cause["place"] != truth["place"]
            if cause["name"].partition("[")[0] != truth["label"] or is_elsewhere:
                continue
            for key, value in true_quantities(truth).items():
                if key in cause["parameters"]:
                    low, high = cause["parameters"][key]["ci90"]
                    inside.append(bool(low <= value <= high))
    return inside


def coil_inside(row: Row, model: str) -> list[bool]:
    """Whether true numbers of the coil lie in their 90 % intervals: without extension, with it, and widened by what is left."""
    if any(cause["label"] in OWN_NUMBERS for cause in row["truth"]):
        return []
    return [bool(n[model][0] <= n["truth"] <= n[model][1]) for n in row["coil"].values()]


def p_unlisted(row: Row) -> float:
    """Probability of something unlisted, as the diagnosis states it; 1 where it ends `unexplained` without a number."""
    absent = row["p_not_in_library"]
    if absent is None:
        return 1.0 if row["verdict"] == "unexplained" else 0.0
    return float(absent)


def tells_of_unlisted(row: Row) -> bool:
    """Whether something unlisted is told: by the verdict or by a probability of at least `TOLD`."""
    return row["verdict"] == "unexplained" or p_unlisted(row) >= TOLD


def link_told(row: Row) -> str | None:
    """The most probable link of something unlisted; None where the diagnosis tells of none."""
    return max(row["links"], key=row["links"].get) if row["links"] else None


def p_of_its_links(row: Row) -> float:
    """Probability that a diagnosis gives to the links in which the unlisted cause may sit; 0 where it tells of none."""
    links = row["links"] or {}
    return float(sum(links.get(link, 0.0) for link in unlisted(row)["links"]))


def link_of_correction(row: Row) -> str | None:
    """The link of the departure with the most evidence, in predictions or of the session alone; None where none was found."""
    correction = row["correction"] or {"parts": [], "of_session": []}
    departures = [*correction["parts"], *correction["of_session"]]
    if not departures:
        return None
    strongest = max(departures, key=lambda part: float(part["log_bayes_factor"]))
    return LINK_OF_DEPARTURE.get(strongest["name"].partition("[")[0])
