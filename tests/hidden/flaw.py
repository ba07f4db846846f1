"""Flaws: what a cause is, and how a scene becomes a record with flaws put in stage by stage.

Order: supply -> robot -> winding -> surroundings -> [field at the sensors] -> sensor -> [noise] -> readout -> record. A flaw takes
the scene at its stage and hands back a changed one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from tests.hidden.protocols import MOTIONS, PROTOCOLS, Array
from tests.hidden.scene import Scene


class Stage(IntEnum):
    """Where on the way a flaw acts; flaws of a scene act in this order."""

    SUPPLY = 0
    ROBOT = 1
    WINDING = 2
    SURROUNDINGS = 3
    SENSOR = 4
    READOUT = 5  # after the noise
    RECORD = 6


@dataclass(frozen=True)
class Known:
    """The true value of one number of a flaw, with its unit (1 for a pure number)."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class Truth:
    """What a diagnosis should find: the place (a sensor, coil1, arm1, room) and the numbers."""

    place: str
    parameters: tuple[Known, ...]


Apply = Callable[[Scene, float, np.random.Generator], tuple[Scene, Truth]]


@dataclass(frozen=True)
class Cause:
    """One way in which a session can be flawed.

    Attributes:
        name: Stable name of the cause.
        unit: Of its size; size 0 is no flaw.
        largest: Largest plausible size.
        apply: Scene, size >= 0 and a generator that draws everything but the size (signs and directions among it) -> flawed scene.
        freedom: How many numbers it has beside those that are drawn from a few (an axis, a sensor).
        is_discrete: It is there (size 1) or not.
        is_random: Its effect is noise of another kind, not a pattern.
        protocols, motions: Where it can happen.
    """

    name: str
    stage: Stage
    unit: str
    largest: float
    apply: Apply
    freedom: int = 1
    is_discrete: bool = False
    is_random: bool = False
    protocols: tuple[str, ...] = PROTOCOLS
    motions: tuple[str, ...] = MOTIONS

    @property
    def has_size(self) -> bool:
        """Whether its visible size can be chosen."""
        return not (self.is_discrete or self.is_random)


@dataclass(frozen=True)
class Flaw:
    """A cause at a size; `seed` fixes all else about it."""

    cause: Cause
    size: float
    seed: int


@dataclass(frozen=True)
class Record:
    """What the laboratory writes down, and the truth about the flaws in it."""

    current_A: Array
    displacement_m: Array
    field_T: Array
    truths: tuple[Truth, ...]


def record(scene: Scene, flaws: Sequence[Flaw], noise: Array | None = None) -> Record:
    """Run a scene through all stages.

    Args:
        scene: Without flaw.
        flaws: Acting in the order of their stages.
        noise: Standard normal, reading by component; None for perfect readings.
    """
    truths: dict[int, Truth] = {}
    order = sorted(range(len(flaws)), key=lambda i: flaws[i].cause.stage)
    pending = [i for i in order if flaws[i].cause.stage >= Stage.SENSOR]
    for i in order[: len(order) - len(pending)]:
        scene, truths[i] = _put_in(flaws[i], scene)
    scene = scene.measured()
    while pending and flaws[pending[0]].cause.stage == Stage.SENSOR:
        i = pending.pop(0)
        scene, truths[i] = _put_in(flaws[i], scene)
    if noise is not None:
        scene = replace(scene, field_T=scene.readings_T + scene.sigma_T * noise)
    commanded = scene.schedule
    scene = replace(scene, current_A=commanded.current_A, displacement_m=commanded.displacement_m)
    for i in pending:
        scene, truths[i] = _put_in(flaws[i], scene)
    return Record(
        scene.current_A,
        scene.displacement_m,
        scene.readings_T,
        tuple(truths[i] for i in range(len(flaws))),
    )


def _put_in(flaw: Flaw, scene: Scene) -> tuple[Scene, Truth]:
    return flaw.cause.apply(scene, flaw.size, np.random.default_rng(flaw.seed))


def afflicted_sensor(scene: Scene, rng: np.random.Generator) -> tuple[npt.NDArray[np.bool_], str]:
    """One of the session's sensors at random: which readings are its, and its name."""
    which = int(rng.integers(len(scene.schedule.sensors)))
    is_its: npt.NDArray[np.bool_] = scene.schedule.sensor == which
    return is_its, scene.schedule.sensors[which].name


def direction(rng: np.random.Generator) -> Array:
    """A unit vector, all directions alike."""
    vector = rng.normal(size=3)
    return np.asarray(vector / np.linalg.norm(vector))


def sign(rng: np.random.Generator) -> float:
    """+1 or -1."""
    return float(rng.choice((-1.0, 1.0)))
