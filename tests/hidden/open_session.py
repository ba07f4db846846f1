"""Sessions of the open world: rigs described in several ways, and flaws of natural size that need not be unlike any other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.causes.surroundings import has_room_for_neighbour
from tests.hidden.coil import Winding
from tests.hidden.flaw import Cause, Flaw, record
from tests.hidden.handed_in import HiddenSession, Visible
from tests.hidden.library import ALL, LATER, patterns
from tests.hidden.protocols import PROTOCOLS, draw_schedule
from tests.hidden.scene import Arm, Scene, ideal_scene
from tests.hidden.session import CLEARANCE_M, LEAST_BORE_M, clearance_m
from tests.hidden.stated_rig import StatedRig, draw_rig
from tests.hidden.visible_size import Adjustable, size_for

MOST_SCENES = 60
CAUSES_TRIED, SHAPES_TRIED = 6, 4  # in one scene
Choice = Callable[[Sequence[str]], Sequence[str]]


def draw_open_session(stream: Sequence[int], choice: Choice | None, sigma: float, seed: int) -> HiddenSession:
    """Draw a session and hide one cause in it, or none.

    Args:
        stream: Numbers of the random stream; they fix everything, with `seed`.
        choice: Which of the causes that can happen in a session may be hidden; None for a clean one.
        sigma: Visible size, after everything that this rig file leaves free was adjusted.
    Raises:
        ValueError: None of the causes becomes that visible at a plausible size.
    """
    rng = np.random.default_rng([*stream, seed])
    for _ in range(MOST_SCENES):
        rig, scene = draw_open_scene(rng)
        flaws: tuple[Flaw, ...] = ()
        visible: tuple[Visible, ...] = ()
        if choice is not None:
            pool = choice(patterns(scene.schedule.protocol, rig.motion))
            found = flaw_among(adjustable_of(rig, scene), pool, sigma, rng) if pool else None
            if found is None:
                continue
            flaws, visible = (found[0],), (Visible(found[1], None),)
        may_have_neighbour = bool(rng.random() < 0.25)
        noise = rng.normal(size=(len(scene.schedule), 3))
        made, unflawed = record(scene, flaws, noise), record(scene, (), noise)
        has_neighbour = may_have_neighbour and has_room_for_neighbour(made.truths)
        has_neighbour |= any(flaw.cause.name == "neighbour_coil" for flaw in flaws)
        return HiddenSession(seed, scene, flaws, visible, made, unflawed, has_neighbour, rig)
    raise ValueError(f"no cause that was asked for reaches {sigma:g} sigma at a plausible size")


def within(library: Collection[str], *, is_known: bool) -> Choice:
    """Causes that a library names, or those that it does not, without those that are only hidden by name."""
    return lambda possible: [n for n in possible if n not in LATER and (n in library) == is_known]


def adjustable_of(rig: StatedRig, scene: Scene) -> Adjustable:
    """What a fit of that rig file can imitate in a session."""
    return Adjustable.of(scene, rig.prior_sd, has_priors=True)


def draw_open_scene(rng: np.random.Generator) -> tuple[StatedRig, Scene]:
    """A session without flaw: protocol, rig file, and the truth from its priors, within two standard deviations."""
    rig, schedule = draw_rig(draw_schedule(PROTOCOLS[int(rng.integers(2))], rng), rng)
    noise_T = 1e-6 * np.exp(rng.uniform(np.log(10.0), np.log(40.0), len(schedule.sensors)))
    while True:
        drawn = {
            n: rig.mean(n) + sd * float(np.clip(rng.normal(), -2.0, 2.0)) for n, sd in rig.prior_sd.items()
        }
        winding = Winding(
            drawn["radius_m"],
            drawn["wire_radius_m"],
            round(drawn["axial_loops"]),
            round(drawn["radial_loops"]),
        )
        scene = _scene(rig, ideal_scene(schedule, winding, np.zeros(3), np.zeros(3), noise_T), drawn)
        if winding.radii_m.min() > LEAST_BORE_M and clearance_m(scene) > CLEARANCE_M:
            return rig, scene


def _scene(rig: StatedRig, scene: Scene, drawn: dict[str, float]) -> Scene:
    """The scene with coil, mount and base where they truly are."""

    def place(prefix: str) -> np.ndarray:
        return np.array([drawn[f"{prefix}{axis}_m"] for axis in "xyz"])

    def turn(prefix: str) -> np.ndarray:
        small = [drawn[f"{prefix}tilt_{axis}_rad"] for axis in "xy"] + [drawn.get(f"{prefix}spin_rad", 0.0)]
        return Rotation.from_rotvec(small).as_matrix()

    if rig.base_rotation is None:
        return replace(scene, coil_position_m=place(""), coil_rotation=turn(""))
    arm = Arm(rig.base_rotation @ turn("base_"), place("base_"), place("mount_"))
    return replace(scene, arm=arm, flange_from_coil=turn("mount_"), turn=scene.schedule.turn)


def flaw_among(
    adjustable: Adjustable, pool: Sequence[str], sigma: float, rng: np.random.Generator
) -> tuple[Flaw, float] | None:
    """A flaw of the wanted visible size, and what that came to; None where no cause of the pool reaches it."""
    for name in rng.permutation(pool)[:CAUSES_TRIED]:
        cause: Cause = ALL[str(name)]
        for _ in range(SHAPES_TRIED):
            shape = int(rng.integers(2**31))
            size = size_for(adjustable, cause, shape, sigma)
            if size is not None:
                flaw = Flaw(cause, size, shape)
                return flaw, adjustable.visible_sigma([flaw])
    return None
