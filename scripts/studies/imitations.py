"""How often something that no list holds takes the name of a listed cause: the weights of `mixture/imitation.py`.

Sessions with listed causes, with something unlisted, and with both are asked what is wrong. Every name that the readings hold for sure is
right or not; relatives of a listed cause that is there do not count. A logistic regression on how clear a name is, and beside what, gives
the weights: a name is right with that probability times the share that listed causes have in its set. A tenth of the sessions at a time is
kept out of it to judge the others' weights.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from estimator.diagnosis import effort, policy
from estimator.diagnosis.first_fit import FirstFit
from estimator.diagnosis.limits import Limits
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.imitation import AT_ITS_LINK
from estimator.diagnosis.mixture.scatter import answer_beside_scatter
from estimator.diagnosis.result import Question
from estimator.effects import EFFECTS
from scripts.studies.hidden_cases import Row, label, options_of, read, rows_of, session_of
from tests.hidden.links import links_of
from tests.hidden.study import draw_case, is_relative, is_same

# How often sessions of each kind are supposed to come: with one or two listed flaws, and beside them nothing unlisted, one thing, or two.
WORLD = {
    "single": 0.5,
    "pair": 0.5,
    "mixed": 1.0,
    "mixed_two": 0.5,
    "unknown12": 0.075,
    "unknown30": 0.075,
}
SURE = 0.9  # probability of a set from which it is counted
N_FOLDS = 10
LEAST = 1e-3  # probability of a right name, and of a wrong one, in the log loss
STRENGTH = 0.01  # of the pull of the weights towards 0
Array = NDArray[np.float64]


def main() -> None:
    options = options_of(__doc__, tuple(WORLD), 40, 630_000, "out/imitations.jsonl").parse_args()
    seeds = range(options.first_seed, options.first_seed + options.cases)
    cases = [(kind, seed) for seed in seeds for kind in options.kinds.split(",")]
    rows_of(cases, run_case, options.out, options.workers, lambda row: f"{row['kind']} {row['seed']}")
    show([row for row in read(options.out).values() if "error" not in row])


def run_case(kind: str, seed: int) -> Row:
    """Hide what the kind says, and ask."""
    hidden = draw_case(kind, seed, EFFECTS)
    session = session_of(hidden)
    question = Question(session.rig, session.source, seed)
    first = FirstFit.of(question, session, None, effort.MOST_READINGS_SEARCHED)
    answer = answer_beside_scatter(first.plain, Limits(), seed, lambda _: None).answer
    truths = [label(cause) for cause in hidden.truth()["causes"]]
    return {"kind": kind, "seed": seed, "names": names_in(answer, truths, len(session.rig.sensors))}


def names_in(answer: Answer, truths: list[str], n_sensors: int) -> list[Row]:
    """Every set of an answer that is sure: whether a listed cause that is there belongs to it, whether its link is right, its features."""
    rows, links = [], {link for truth in truths for link in links_of(truth, n_sensors)}
    for entry in answer.found:
        listed = [p.cause for p in entry.possibilities if p.is_listed]
        is_right = any(is_same(cause.name, truth) for cause in listed for truth in truths)
        is_like = any(is_relative(c.name, truth) for c in listed for truth in truths if truth in EFFECTS)
        if entry.with_all < SURE or not listed or (is_like and not is_right):
            continue
        standing = answer.standing(listed[0], [p.cause for p in entry.possibilities])
        share = entry.listed_share / (1.0 - standing.p_imitation)
        names = [cause.label for cause in listed]
        is_at_link = bool(links & set(entry.family.links))
        told = {"names": names, "is_right": is_right, "is_at_link": is_at_link, "share": share}
        rows.append(told | {"features": standing.features})
    return rows


def show(rows: list[Row]) -> None:
    """Print the weights, and what names are worth that got each probability."""
    names = [(i, row["kind"], name) for i, row in enumerate(rows) for name in row["names"]]
    fold = np.array([i % N_FOLDS for i, _, _ in names])
    of_kind = Counter(row["kind"] for row in rows)
    counts = np.array([WORLD[kind] * len(rows) / (len(of_kind) * of_kind[kind]) for _, kind, _ in names])
    features = np.array([name["features"] for _, _, name in names])
    share = np.array([name["share"] for _, _, name in names])
    is_right = np.array([name["is_right"] for _, _, name in names], dtype=float)
    for kind in WORLD:
        own = [name["is_right"] for _, its_kind, name in names if its_kind == kind]
        print(f"{kind}: {len(own)} names in {of_kind[kind]} sessions, {sum(own)} right")
    at_link = [name["is_at_link"] for _, _, name in names if not name["is_right"]]
    print(f"something acts at the link of {sum(at_link)} of {len(at_link)} imitations; {AT_ITS_LINK} in use")
    weights = weights_of(features, share, is_right, counts)
    print(f"weights {', '.join(f'{w:.2f}' for w in weights)}; in use {policy.IMITATION}")
    p = np.empty(len(names))
    for k in range(N_FOLDS):
        rest = fold != k
        p[~rest] = probability(
            weights_of(features[rest], share[rest], is_right[rest], counts[rest]),
            features[~rest],
            share[~rest],
        )
    in_use = probability(np.array(policy.IMITATION), features, share)
    for words, stated in (("sessions that were kept out", p), ("weights in use", in_use)):
        print(f"{words}: log loss {(counts * log_loss(stated, is_right)).sum() / counts.sum():.3f}")
        for least, most in pairwise((0.0, 0.5, 0.8, 0.9, 0.95, 1.0)):
            some = (stated >= least) & (stated < most)
            right = (counts * is_right)[some].sum() / max(counts[some].sum(), 1e-300)
            print(
                f"  {least:.2f} to {most:.2f}: {int(some.sum())} names, {100 * right:.0f} % right in that world"
            )


def probability(weights: Array, features: Array, share: Array) -> Array:
    """Probability that names are right."""
    return share / (1.0 + np.exp(-features @ weights))


def log_loss(p: Array, is_right: Array) -> Array:
    """Minus the log probability of what is true of each name."""
    p = p.clip(LEAST, 1.0 - LEAST)
    return -is_right * np.log(p) - (1.0 - is_right) * np.log(1.0 - p)


def weights_of(features: Array, share: Array, is_right: Array, counts: Array) -> Array:
    """Weights of a logistic regression."""

    def loss(weights: Array) -> float:
        misses = log_loss(probability(weights, features, share), is_right)
        return float((counts * misses).sum() + STRENGTH * weights @ weights)

    result: Array = minimize(loss, np.zeros(features.shape[1])).x
    return result


if __name__ == "__main__":
    main()
