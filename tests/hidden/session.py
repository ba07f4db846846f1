"""Sessions with hidden flaws, drawn from a seed: coil and pose from the priors of the rig file, noise from 10 to 40 microtesla."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from tests.hidden.causes.surroundings import has_room_for_neighbour
from tests.hidden.coil import Winding
from tests.hidden.flaw import Cause, Flaw, record
from tests.hidden.handed_in import HiddenSession, Visible
from tests.hidden.library import ALL, OUTSIDE
from tests.hidden.protocols import draw_schedule
from tests.hidden.rivals import known_rivals, rival_of, unlike_any_two_sigma, unlike_sigma
from tests.hidden.scene import Scene, ideal_scene
from tests.hidden.visible_size import PRIOR_SD, Adjustable, crossing

NOMINAL = {"radius_m": 0.048, "wire_radius_m": 0.00046, "axial_loops": 45.0, "radial_loops": 22.0}
CLEARANCE_M = 0.008  # of every reading from the winding
LEAST_BORE_M = 0.005
SHAPES_TRIED = 12


def draw_session(
    seed: int,
    cause: str | Sequence[str] | None = None,
    visible_sigma: float = 8.0,
    protocol: str = "paper",
) -> HiddenSession:
    """Draw a session and hide causes in it.

    Args:
        seed: Fixes everything.
        cause: Name, names, or None for a clean session.
        visible_sigma: Wanted visible size: of each cause, given the others; of a cause outside the library, of the part that no two
            known ones imitate. Discrete causes are there whatever it is; noise is drawn between half and all of its largest plausible size.
        protocol: `paper` or `recommended`.
    Raises:
        ValueError: The cause cannot happen in the protocol, or cannot become that visible at a plausible size.
    """
    names = (cause,) if isinstance(cause, str) else tuple(cause or ())
    causes = tuple(ALL[name] for name in names)
    for one in causes:
        if protocol not in one.protocols:
            raise ValueError(f"{one.name} cannot happen in protocol {protocol!r}")
    rng = np.random.default_rng([77, seed])
    scene = draw_ideal(protocol, rng)
    hidden = _hide(Adjustable.of(scene), causes, visible_sigma, rng)
    flaws = tuple(flaw for flaw, _ in hidden)
    may_have_neighbour = bool(rng.random() < 0.25)
    noise = rng.normal(size=(len(scene.schedule), 3))
    made, unflawed = record(scene, flaws, noise), record(scene, (), noise)
    has_neighbour = (may_have_neighbour and has_room_for_neighbour(made.truths)) or "neighbour_coil" in names
    visible = tuple(visible for _, visible in hidden)
    return HiddenSession(seed, scene, flaws, visible, made, unflawed, has_neighbour)


def draw_ideal(protocol: str, rng: np.random.Generator) -> Scene:
    """A session without flaw whose coil comes from the rig file's priors, within two standard deviations."""
    schedule = draw_schedule(protocol, rng)
    while True:
        draw = {name: sd * np.clip(rng.normal(), -2.0, 2.0) for name, sd in PRIOR_SD.items()}
        drawn = {name: value + draw[name] for name, value in NOMINAL.items()}
        winding = Winding(
            drawn["radius_m"],
            drawn["wire_radius_m"],
            round(drawn["axial_loops"]),
            round(drawn["radial_loops"]),
        )
        position_m = np.array([draw["x_m"], draw["y_m"], draw["z_m"] - schedule.distance_m])
        tilt_rad = np.array([draw["tilt_x_rad"], draw["tilt_y_rad"], 0.0])
        noise_T = 1e-6 * np.exp(rng.uniform(np.log(10.0), np.log(40.0), len(schedule.sensors)))
        scene = ideal_scene(schedule, winding, position_m, tilt_rad, noise_T)
        if winding.radii_m.min() > LEAST_BORE_M and clearance_m(scene) > CLEARANCE_M:
            return scene


def _hide(
    adjustable: Adjustable, causes: Sequence[Cause], target: float, rng: np.random.Generator
) -> list[tuple[Flaw, Visible]]:
    """Flaws of the wanted visible size; other shapes of a cause are tried where one cannot become visible."""
    hidden = []
    for one in causes:
        rivals = [rival_of(adjustable, other) for other in causes if other is not one and other.has_size]
        unlike = unlike_sigma
        if one.name in OUTSIDE:
            rivals, unlike = [*rivals, *known_rivals(adjustable)], unlike_any_two_sigma
        for _ in range(SHAPES_TRIED):
            shape = int(rng.integers(2**31))
            size: float | None = 1.0 if one.is_discrete else one.largest * rng.uniform(0.5, 1.0)
            if one.has_size:
                size = crossing(adjustable, one, shape, target, partial(unlike, rivals=rivals))
            if size is not None:
                break
        else:
            raise ValueError(f"{one.name} does not reach {target:g} sigma at a plausible size")
        flaw = Flaw(one, size, shape)
        left_over = adjustable.left_over([flaw])
        unlike_them = unlike(left_over, rivals) if one.has_size else None
        hidden.append((flaw, Visible(float(np.linalg.norm(left_over)), unlike_them)))
    return hidden


def clearance_m(scene: Scene) -> float:
    """Least distance of a reading from the winding's front face; readings level with the winding count as 0."""
    return float(scene.in_coil_frame(scene.sensor_position_m)[:, 2].min())
