"""What of a hidden flaw another cause could imitate: two causes of a session, or a cause outside the library beside those within.

A cause is given as draws of everything but its size, and imitates with as many of them as it has numbers, mixed freely: those that fit
best, one after another. That stands for the fit of a cause, which may be curved in its numbers (the place of an iron body, which
therefore has more draws). What two known causes imitate together no diagnosis can call unknown: a cause outside the library is
measured by what is left beside any two of them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from tests.hidden.broad import BROAD
from tests.hidden.flaw import Cause, Flaw, record
from tests.hidden.library import ALL, CAUSES, names
from tests.hidden.protocols import Array
from tests.hidden.visible_size import Adjustable, effect_T, unexpected_T, whiten

DRAWS, DRAWS_OF_PLACES = 24, 100
PLACED = (
    "iron_plate",
    "iron_body",
    "second_iron_body",
    "magnetised_link",
    "hidden_winding",
    "periodic_interference",
)
BEST_FIRST = 4  # of the rivals, to be joined by a second
SMALL_SHARE = 0.02  # of the largest plausible size, where most causes are linear
FIRST_SEED = 9000
LEAST_SIGMA = 1.0  # a draw less visible than this at its largest plausible size imitates nothing


@dataclass(frozen=True)
class Rival:
    """Effects of a cause on the whitened components, less what the base model imitates.

    Attributes:
        columns: Component by draw.
        freedom: How many draws may be mixed.
    """

    name: str
    columns: Array
    freedom: int

    def rest(self, left_over: Array) -> Array:
        """What stays of a whitened effect (that the base model is cleared from) when this cause imitates what it can."""
        rest, columns = left_over, self.columns
        for _ in range(min(self.freedom, columns.shape[1])):
            length = np.linalg.norm(columns, axis=0)
            usable = length > 1e-6 * length.max()
            fit = np.where(usable, np.abs(rest @ columns) / np.where(usable, length, 1.0), -1.0)
            unit = columns[:, np.argmax(fit)] / length[np.argmax(fit)]
            rest = rest - unit * (unit @ rest)
            columns = columns - np.outer(unit, unit @ columns)
        return rest

    def left_over(self, left_over: Array) -> float:
        """Norm of that rest."""
        return float(np.linalg.norm(self.rest(left_over)))


def rival_of(adjustable: Adjustable, cause: Cause) -> Rival:
    """A cause as it could act in a session."""
    draws = DRAWS_OF_PLACES if cause.name in PLACED else DRAWS
    flaws = [Flaw(cause, SMALL_SHARE * cause.largest, FIRST_SEED + k) for k in range(draws)]
    effects = [whiten(adjustable.scene, effect_T(adjustable.scene, [flaw])) for flaw in flaws]
    columns = adjustable.cleared(np.stack(effects, axis=1))
    is_visible = np.linalg.norm(columns, axis=0) > LEAST_SIGMA * SMALL_SHARE
    return Rival(cause.name, columns[:, is_visible], cause.freedom)


def left_beside(adjustable: Adjustable, flaw: Flaw, library: Collection[str]) -> dict[str, float]:
    """What of a flaw no fit of one cause of a library imitates, in sigmas, by that cause; the best imitation first.

    Each cause acts at one place, as broadly as a library may fit it.
    """
    schedule, left_over = adjustable.scene.schedule, adjustable.left_over([flaw])
    possible = [n for n in (*ALL, *BROAD) if n in library and n != flaw.cause.name]
    causes = [BROAD.get(name) or ALL[name] for name in dict.fromkeys(possible)]
    rests = {
        cause.name: unlike_sigma(left_over, rivals_by_place(adjustable, cause))
        for cause in causes
        if cause.has_size and schedule.protocol in cause.protocols and schedule.motion in cause.motions
    }
    return dict(sorted(rests.items(), key=lambda item: item[1]))


def rivals_by_place(adjustable: Adjustable, cause: Cause) -> list[Rival]:
    """A cause as it could act at each of its places in a session."""
    columns: dict[str, list[Array]] = {}
    for k in range(DRAWS_OF_PLACES if cause.name in PLACED else DRAWS):
        made = record(adjustable.scene, [Flaw(cause, SMALL_SHARE * cause.largest, FIRST_SEED + k)])
        effect = adjustable.cleared(whiten(adjustable.scene, unexpected_T(adjustable.scene, made)))
        if np.linalg.norm(effect) > LEAST_SIGMA * SMALL_SHARE:
            columns.setdefault(made.truths[0].place, []).append(effect)
    return [Rival(cause.name, np.stack(mine, axis=1), cause.freedom) for mine in columns.values()]


def known_rivals(adjustable: Adjustable) -> list[Rival]:
    """All causes of the library that a session could show as a pattern."""
    return [rival_of(adjustable, CAUSES[name]) for name in names(adjustable.scene.schedule.protocol)]


def unlike_sigma(left_over: Array, rivals: Sequence[Rival]) -> float:
    """The part of a whitened effect that no single rival imitates, in sigmas."""
    return min((rival.left_over(left_over) for rival in rivals), default=float(np.linalg.norm(left_over)))


def unlike_any_two_sigma(left_over: Array, rivals: Sequence[Rival]) -> float:
    """The part of a whitened effect that no two rivals imitate together, in sigmas: the best few are joined by every other."""
    rests = sorted((rival.rest(left_over) for rival in rivals), key=lambda rest: float(np.linalg.norm(rest)))
    return min(unlike_sigma(rest, rivals) for rest in rests[:BEST_FIRST])
