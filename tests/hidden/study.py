"""Cases of the hidden-effect study: what is hidden, and how a verdict is compared with it."""

from __future__ import annotations

from typing import Any

import numpy as np

from tests.hidden.handed_in import HiddenSession
from tests.hidden.library import names
from tests.hidden.session import draw_session

KINDS = ("single", "clean", "pair", "outside", "discrete")
PROTOCOLS = ("paper", "recommended")
SIGMA = 8.0
DISCRETE = ("axes_swapped", "unit_error", "left_handed", "displacement_frame", "current_sign")
MOST_TRIES = 40


def draw_case(kind: str, seed: int) -> HiddenSession:
    """A session of a kind; protocol and causes are drawn from the seed."""
    rng = np.random.default_rng([991, KINDS.index(kind), seed])
    protocol = PROTOCOLS[int(rng.integers(2))]
    for _ in range(MOST_TRIES):
        causes: tuple[str, ...] = ()
        if kind == "single":
            causes = (str(rng.choice(names(protocol))),)
        elif kind == "pair":
            causes = tuple(str(one) for one in rng.choice(names(protocol), 2, replace=False))
        elif kind == "outside":
            causes = (str(rng.choice(names(protocol, is_known=False))),)
        elif kind == "discrete":
            causes = (str(rng.choice(DISCRETE)),)
        try:
            return draw_session(seed, causes, SIGMA, protocol)
        except ValueError:
            continue  # the cause cannot become visible in this session
    raise RuntimeError(f"no {kind} session for seed {seed}")


def label(cause: dict[str, Any]) -> str:
    """Name of a true cause as the diagnosis would write it, without its place."""
    return str(cause["name"])


def credible_sets(row: dict[str, Any]) -> list[list[str]]:
    """Of every cause that was named, the names in its 95 % credible set, without places."""
    sets = []
    for cause in row["causes"]:
        members = [cause["name"], *(other["name"] for other in cause["alternatives"])]
        sets.append(
            sorted(
                {name.partition("[")[0] for name in members}, key=[m.partition("[")[0] for m in members].index
            )
        )
    return sets
