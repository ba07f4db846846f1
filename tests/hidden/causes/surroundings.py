"""Flaws of the surroundings: fields and iron that stay with the room while the coil moves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.coil import MU0, Winding, blocks_of, circular_field
from tests.hidden.flaw import Cause, Known, Stage, Truth, direction, sign
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene, Source

# The neighbour's winding and place are in the rig file, exactly.
NEIGHBOUR = Winding(0.048, 0.00046, 45, 22)
NEIGHBOUR_POSITION_M = (0.06, 0.03, 0.1)

# Along x, y, z: where the coil's travel ends, and what the sensor's holder needs.
NEAREST_PLATE_M = (0.13, 0.13, 0.05)


def has_room_for_neighbour(truths: Iterable[Truth]) -> bool:
    """Whether an idle second coil would stand in no plate of iron."""
    for truth in truths:
        numbers = {known.name: known.value for known in truth.parameters}
        if "normal_x" in numbers:
            along_m = sum(
                numbers[f"normal_{axis}"] * at for axis, at in zip("xyz", NEIGHBOUR_POSITION_M, strict=True)
            )
            if abs(along_m - numbers["distance_m"]) < NEIGHBOUR.radius_m + NEIGHBOUR.length_m:
                return False
    return True


def with_source(scene: Scene, source: Source) -> Scene:
    """The scene with one more field."""
    return replace(scene, sources=(*scene.sources, source))


def background_field(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A uniform, steady field in the room."""
    field_T = size * direction(rng)
    return with_source(scene, lambda _, points_m: np.broadcast_to(field_T, points_m.shape)), Truth(
        "room", vector("background", field_T, "T")
    )


def background_drift(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A uniform field that grows evenly from 0 at the first reading to `size` at the last."""
    time_s = scene.schedule.time_s
    rate_T_per_s = size * direction(rng) / (time_s[-1] - time_s[0])
    drift_T = (time_s - time_s[0])[:, None] * rate_T_per_s
    return with_source(scene, lambda *_: drift_T), Truth("room", vector("rate", rate_T_per_s, "T/s"))


def iron_plate(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A wide, thick plate of soft iron behind a plane, its normal within 10 degrees of a room's axis: the coil's mirror image.

    The image carries the mirrored current, as the field must leave iron at right angles. The plane lies `distance_m` from the room's
    origin along `normal`, the iron beyond it: beside the coil's travel (x, y) or beyond the sensor (z). size = (nearest / distance)^3,
    where nearest is `NEAREST_PLATE_M` of that axis.
    """
    k = int(rng.integers(3))
    normal = np.zeros(3)
    normal[k] = sign(rng) if k < 2 else 1.0
    normal = Rotation.from_rotvec(np.deg2rad(10.0) * rng.uniform(-1.0, 1.0, 3) / np.sqrt(3.0)).apply(normal)
    distance_m = NEAREST_PLATE_M[k] / np.cbrt(size) if size > 0.0 else np.inf
    mirror = np.eye(3) - 2.0 * np.outer(normal, normal)

    def image(now: Scene, points_m: Array) -> Array:
        # A field is an axial vector: mirrored currents make -M B(M p).
        return -now.coil_field_at(points_m @ mirror + 2.0 * distance_m * normal) @ mirror

    truth = Truth("room", (Known("distance_m", distance_m, "m"), *vector("normal", normal, "1")))
    return (with_source(scene, image) if size > 0.0 else scene), truth


def iron_body(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """A small soft iron sphere beyond the sensor, seen from the coil: a dipole along the coil's field at its centre.

    m = 4 pi a^3 B / mu0 for large permeability; size is a^3 in m^3.
    """
    place_m = place_beyond_sensor(rng)
    truth = Truth("room", (Known("radius_m", np.cbrt(size), "m"), *vector("position", place_m, "m")))
    return with_source(scene, induced_dipole(place_m, size)), truth


def place_beyond_sensor(rng: np.random.Generator) -> Array:
    """45 to 90 mm from the room's origin and at least 30 mm beyond it, where the coil does not reach."""
    while True:
        place_m = rng.uniform(0.045, 0.09) * direction(rng)
        if place_m[2] > 0.03:
            return np.asarray(place_m)


def induced_dipole(place_m: Array, cubed_radius_m3: float) -> Source:
    """Field of a soft sphere that the coil magnetises."""

    def field(now: Scene, points_m: Array) -> Array:
        at_body_T = now.coil_field_at(np.broadcast_to(place_m, points_m.shape))
        return dipole_field(points_m - place_m, 4.0 * np.pi * cubed_radius_m3 / MU0 * at_body_T)

    return field


def dipole_field(arm_m: Array, moment_A_m2: Array) -> Array:
    """Field of dipoles at `arm_m` from them, row by row."""
    distance_m = np.linalg.norm(arm_m, axis=1, keepdims=True)
    unit = arm_m / distance_m
    along = (unit * moment_A_m2).sum(axis=1, keepdims=True)
    return np.asarray(MU0 / (4.0 * np.pi) * (3.0 * along * unit - moment_A_m2) / distance_m**3)


def neighbour_coil(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The idle neighbour coil2, whose winding and place the rig knows, carries a share of coil1's current (cross-talk of the amplifier)."""
    share = sign(rng) * size
    field = circular_field(blocks_of(NEIGHBOUR))
    position_m = np.array(NEIGHBOUR_POSITION_M)
    rotation = Rotation.from_rotvec(neighbour_rotation_rad()).as_matrix()

    def leak(now: Scene, points_m: Array) -> Array:
        per_ampere = field((points_m - position_m) @ rotation) @ rotation.T
        return np.asarray(share * now.current_A[:, None] * per_ampere)

    return with_source(scene, leak), Truth("coil2", (Known("share", share, "1"),))


def neighbour_rotation_rad() -> Array:
    """Rotation vector of world_from_coil2: its front face looks at the room's origin."""
    towards = -np.array(NEIGHBOUR_POSITION_M) / np.linalg.norm(NEIGHBOUR_POSITION_M)
    turn = np.cross([0.0, 0.0, 1.0], towards)
    sine = np.linalg.norm(turn)
    return np.asarray(turn / sine * np.arctan2(sine, towards[2]))


def vector(name: str, value: Array, unit: str) -> tuple[Known, ...]:
    """Three components as `name_x_unit` and so on; a pure number's name ends without unit."""
    end = "" if unit == "1" else "_" + unit.replace("/", "_per_")
    return tuple(Known(f"{name}_{axis}{end}", float(v), unit) for axis, v in zip("xyz", value, strict=True))


CAUSES = (
    Cause("background_field", Stage.SURROUNDINGS, "T", 200e-6, background_field, freedom=3),
    Cause("background_drift", Stage.SURROUNDINGS, "T", 200e-6, background_drift, freedom=3),
    Cause("iron_plate", Stage.SURROUNDINGS, "1", 1.0, iron_plate, freedom=3),
    Cause("iron_body", Stage.SURROUNDINGS, "m3", 2.7e-5, iron_body, freedom=4),
    Cause("neighbour_coil", Stage.SURROUNDINGS, "1", 0.1, neighbour_coil),
)
