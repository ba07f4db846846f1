"""Mixed sessions: one or two causes of coilcal's list, and beside them one or two that no list holds.

Each has a visible size of its own, as if it were alone. A session counts only where each is as visible beside the others, where
none of the listed ones does what another does, and where they do not explain the unlisted one away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tests.hidden.causes.surroundings import has_room_for_neighbour
from tests.hidden.flaw import Flaw, record
from tests.hidden.handed_in import HiddenSession, Visible
from tests.hidden.library import patterns
from tests.hidden.links import (
    LISTED,
    UNDER_ANOTHER_NAME,
    UNLISTED,
    WITH_ONE_SENSOR_NEARLY,
    WITH_ONE_SENSOR_UNDER_ANOTHER_NAME,
)
from tests.hidden.open_session import adjustable_of, draw_open_scene, flaw_among
from tests.hidden.protocols import Array
from tests.hidden.rivals import rival_of, unlike_sigma
from tests.hidden.scene import Scene
from tests.hidden.session import CLEARANCE_M, clearance_m
from tests.hidden.stated_rig import StatedRig
from tests.hidden.visible_size import Adjustable, effect_T, whiten

LISTED_SIGMA, UNLISTED_SIGMA = (8.0, 40.0), (5.0, 30.0)
POSE_SHARE, SEVERAL_SHARE, PAIR_SHARE = 0.5, 1.0 / 3.0, 0.5
MOST_SCENES, MIXTURES_TRIED = 60, 3  # the latter in one scene
LEAST_UNLIKE_SIGMA = 3.0
PRESENT = 0.2  # by which the size beside the others may differ from that alone
# These put the field of a winding, or a sensor's reading, in place of what was there; within their stage they act first, in this order.
REPLACING = (
    "axial_pitch",
    "radial_pitch",
    "winding_misstated",
    "turns_gradient",
    "short_layer",
    "sensor_lag",
)
TWO_SENSORS = ("mover_slipped", "channel_crosstalk")  # nothing of their own with one sensor


@dataclass(frozen=True)
class Mixture:
    """What a session is to be.

    Attributes:
        is_pose: The arm writes down poses of its flange; else displacements or joint angles, two to one.
        has_several: Several sensors; else one, in either protocol.
        listed_sigma, unlisted_sigma: Visible sizes.
    """

    is_pose: bool
    has_several: bool
    listed_sigma: tuple[float, ...]
    unlisted_sigma: tuple[float, ...]


def draw_mixture(rng: np.random.Generator, n_unlisted: int = 1) -> Mixture:
    """Shares of `POSE_SHARE`, `SEVERAL_SHARE` and `PAIR_SHARE`; sizes even in their logarithm."""
    is_pose, has_several = bool(rng.random() < POSE_SHARE), bool(rng.random() < SEVERAL_SHARE)
    n_listed = 1 + int(rng.random() < PAIR_SHARE)
    between = [LISTED_SIGMA] * n_listed + [UNLISTED_SIGMA] * n_unlisted
    sigmas = tuple(float(np.exp(rng.uniform(*np.log(some)))) for some in between)
    return Mixture(is_pose, has_several, sigmas[:n_listed], sigmas[n_listed:])


def draw_mixed_session(stream: Sequence[int], seed: int, n_unlisted: int = 1) -> HiddenSession:
    """Draw a session and hide a mixture in it; the stream and the seed fix everything.

    Raises:
        ValueError: No mixture reaches its visible sizes in any of the scenes.
    """
    rng = np.random.default_rng([*stream, seed])
    mixture = draw_mixture(rng, n_unlisted)
    for _ in range(MOST_SCENES):
        rig, scene = draw_mixed_scene(mixture, rng)
        adjustable = adjustable_of(rig, scene)
        for _ in range(MIXTURES_TRIED):
            flaws = flaws_of(adjustable, mixture, rng)
            visible = visible_of(adjustable, flaws) if flaws else ()
            if visible:
                return _session(seed, rig, scene, flaws, visible, rng)
    raise ValueError(f"no mixture of seed {seed} reaches its visible sizes")


def draw_mixed_scene(mixture: Mixture, rng: np.random.Generator) -> tuple[StatedRig, Scene]:
    """A session without flaw whose arm and sensors are as wanted."""
    protocol = "recommended" if mixture.has_several or rng.random() < 0.5 else "paper"
    while True:
        rig, scene = draw_open_scene(rng)
        if scene.schedule.protocol != protocol or (rig.motion == "pose") != mixture.is_pose:
            continue
        if not mixture.has_several:
            scene = of_first_sensor(scene)
        if clearance_m(scene) > CLEARANCE_M:
            return rig, scene


def of_first_sensor(scene: Scene) -> Scene:
    """The session in which the first sensor takes all readings."""
    first = int(np.argmax(scene.schedule.sensor == 0))
    schedule = replace(
        scene.schedule,
        sensors=scene.schedule.sensors[:1],
        sensor=np.zeros_like(scene.schedule.sensor),
    )
    n = len(schedule)
    return replace(
        scene,
        schedule=schedule,
        noise_T=scene.noise_T[:1],
        sensor_position_m=np.repeat(scene.sensor_position_m[first : first + 1], n, axis=0),
        world_from_sensor=np.repeat(scene.world_from_sensor[first : first + 1], n, axis=0),
    )


def possible(scene: Scene, names: Sequence[str]) -> list[str]:
    """Causes of some that can happen in a session, at a visible size, and are no other's twin there."""
    schedule, left_out = scene.schedule, set(UNDER_ANOTHER_NAME)
    if len(schedule.sensors) == 1:
        left_out |= {*TWO_SENSORS, *WITH_ONE_SENSOR_UNDER_ANOTHER_NAME}
    return [n for n in patterns(schedule.protocol, schedule.motion) if n in names and n not in left_out]


def in_order(flaws: Sequence[Flaw]) -> tuple[Flaw, ...]:
    """Flaws so that none undoes one that acted at its stage before it."""
    return tuple(sorted(flaws, key=lambda flaw: (*REPLACING, flaw.cause.name).index(flaw.cause.name)))


def beside_sigma(adjustable: Adjustable, flaws: Sequence[Flaw]) -> list[float]:
    """Visible size of what each flaw adds to a session that has the others."""
    scene = adjustable.scene

    def effect(hidden: Sequence[Flaw]) -> Array:
        return whiten(scene, effect_T(scene, hidden))

    every = effect(flaws)
    added = [every - effect([other for other in flaws if other is not one]) for one in flaws]
    return [float(np.linalg.norm(adjustable.cleared(one))) for one in added]


def flaws_of(adjustable: Adjustable, mixture: Mixture, rng: np.random.Generator) -> tuple[Flaw, ...]:
    """Flaws of the wanted sizes; none where a size is out of reach, or one sensor takes the unlisted cause for a listed one."""
    void = WITH_ONE_SENSOR_NEARLY if len(adjustable.scene.schedule.sensors) == 1 else ()
    flaws: list[Flaw] = []
    wanted = [(sigma, LISTED) for sigma in mixture.listed_sigma]
    wanted += [(sigma, UNLISTED) for sigma in mixture.unlisted_sigma]
    for sigma, names in wanted:
        taken = [flaw.cause.name for flaw in flaws]
        pool = [name for name in possible(adjustable.scene, names) if name not in taken]
        drawn = flaw_among(adjustable, pool, sigma, rng)
        if drawn is None or drawn[0].cause.name in void:
            return ()
        flaws.append(drawn[0])
    return in_order(flaws)


def visible_of(adjustable: Adjustable, flaws: Sequence[Flaw]) -> tuple[Visible, ...]:
    """How visible each flaw is, alone and beside the other listed ones at any size; none where the mixture does not count."""
    sigmas = [adjustable.visible_sigma([flaw]) for flaw in flaws]
    beside = beside_sigma(adjustable, flaws)
    if any(abs(there / alone - 1.0) > PRESENT for there, alone in zip(beside, sigmas, strict=True)):
        return ()
    moved = [adjustable.sigma_once_moved([flaw]) for flaw in flaws]
    if any(left < (1.0 - PRESENT) * sigma for left, sigma in zip(moved, sigmas, strict=True)):
        return ()  # a fit of the rig as described follows it
    rivals = {f.cause.name: rival_of(adjustable, f.cause) for f in flaws if f.cause.name in LISTED}
    visible = []
    for flaw, sigma in zip(flaws, sigmas, strict=True):
        others = [rival for name, rival in rivals.items() if name != flaw.cause.name]
        unlike = unlike_sigma(adjustable.left_over([flaw]), others)
        if unlike < LEAST_UNLIKE_SIGMA:
            return ()
        visible.append(Visible(sigma, unlike))
    return tuple(visible)


def _session(
    seed: int,
    rig: StatedRig,
    scene: Scene,
    flaws: tuple[Flaw, ...],
    visible: tuple[Visible, ...],
    rng: np.random.Generator,
) -> HiddenSession:
    """The session with its noise, and an idle neighbour in a quarter of them."""
    may_have_neighbour = bool(rng.random() < 0.25)
    noise = rng.normal(size=(len(scene.schedule), 3))
    made, unflawed = record(scene, flaws, noise), record(scene, (), noise)
    has_neighbour = may_have_neighbour and has_room_for_neighbour(made.truths)
    has_neighbour |= any(flaw.cause.name == "neighbour_coil" for flaw in flaws)
    return HiddenSession(seed, scene, flaws, visible, made, unflawed, has_neighbour, rig)
