"""Four flaws that public reports describe, of a size that can be chosen: a supply that reaches its voltage, fields in the axes of a base
or of the room, currents without their sign, a pose or a reading that is the one before.

A limit has a size of its own. The others are there or not: the weaker the coil, the less they show.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tests.hidden.flaw import Cause, Flaw, Known, Record, Stage, Truth, record
from tests.hidden.handed_in import HiddenSession, Visible
from tests.hidden.protocols import Array
from tests.hidden.scene import Scene
from tests.hidden.session import draw_ideal
from tests.hidden.visible_size import PRIOR_SD, Adjustable, unexpected_T, whiten

SIZES = (1.0, 0.85, 0.7, 0.5, 0.3)  # of currents, over the largest
SMALLEST_SHARE = 1e-4  # of the coil's usual current
LARGEST_TURN_RAD = 0.6


@dataclass(frozen=True)
class Reported:
    """A session with one of these flaws.

    Attributes:
        session: As it is handed in.
        right: The same session without the flaw, the same noise in it.
        sigma: Visible size of the flaw, in all.
        row_sigma: Root mean square over the rows that the flaw changes of their change, in standard deviations of the noise.
        changed: These rows.
    """

    session: HiddenSession | CarriedSession
    right: HiddenSession | CarriedSession
    sigma: float
    row_sigma: float
    changed: npt.NDArray[np.int64]


@dataclass(frozen=True)
class CarriedSession:
    """A coil that stands still, and an arm in a base of its own that turns the sensor."""

    scene: Scene
    made: Record
    base: Rotation
    flange_m: Array
    flange: Rotation

    def write(self, folder: Path) -> None:
        """Write `rig.yaml` and `readings.csv`."""
        schedule, rotation_rad = self.scene.schedule, self.base.as_rotvec()
        turn = ", ".join(
            f"r{axis}_rad: {value:.15g}" for axis, value in zip("xyz", rotation_rad, strict=True)
        )
        z_mm = -1e3 * schedule.distance_m
        (folder / "rig.yaml").write_text(_RIG.format(base=turn, z_mm=z_mm), encoding="utf-8")
        columns = np.column_stack(
            (schedule.time_s, self.made.current_A, self.flange_m, self.flange.as_rotvec(), self.made.field_T)
        )
        sets = np.where(schedule.is_validation, "validation", "calibration")
        lines = [
            _HEADER,
            *(",".join([*map(repr, row), kind]) for row, kind in zip(columns.tolist(), sets, strict=True)),
        ]
        (folder / "readings.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def draw_reported(kind: str, seed: int, sigma: float, row_sigma: float) -> Reported:
    """Hide one of `KINDS`; a limit or a frame is `sigma` visible in all, a wrong row changes by `row_sigma`."""
    rng = np.random.default_rng([561, seed])
    if kind == "recorded_frame":
        return _in_another_frame(rng, sigma)
    scene = draw_ideal("recommended", rng)
    largest_A, n = np.abs(scene.current_A).max(), len(scene.schedule)
    scene = _driven(scene, largest_A * rng.choice(SIZES, n) * rng.choice((-1.0, 1.0), n))
    cause, shape, noise = KINDS[kind], int(rng.integers(2**31)), rng.normal(size=(len(scene.schedule), 3))
    if cause.has_size:
        adjustable = Adjustable.of(scene)
        size = _where(lambda size: adjustable.visible_sigma([Flaw(cause, size, shape)]), sigma, cause.largest)
        flaw = Flaw(cause, size, shape)
    else:
        flaw = Flaw(cause, 1.0, shape)
        share = _where(lambda share: _row_sigma(_weaker(scene, share), flaw)[0], row_sigma, 1.0)
        scene = _weaker(scene, share)
    visible = Adjustable.of(scene).visible_sigma([flaw])
    made, unflawed = record(scene, (flaw,), noise), record(scene, (), noise)
    session = HiddenSession(
        seed, scene, (flaw,), (Visible(visible, None),), made, unflawed, has_neighbour=False
    )
    return Reported(session, session.without_flaws(), visible, *_row_sigma(scene, flaw))


def _where(measure: Callable[[float], float], target: float, largest: float) -> float:
    """Size, or share of the current, at which a measure that grows with it meets a target; the largest where it stays below."""
    low, high = SMALLEST_SHARE * largest, largest
    if measure(high) <= target:
        return high
    for _ in range(25):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if measure(middle) < target else (low, middle)
    return high


def _row_sigma(scene: Scene, flaw: Flaw) -> tuple[float, npt.NDArray[np.int64]]:
    """Root mean square change of the rows that a flaw changes, in standard deviations, and these rows."""
    change = np.abs(unexpected_T(scene, record(scene, (flaw,)))) / scene.sigma_T
    sizes = np.linalg.norm(change, axis=1)
    wrong = np.flatnonzero(sizes > 0.0)
    return float(np.sqrt(np.square(sizes[wrong]).mean())), wrong


def _weaker(scene: Scene, share: float) -> Scene:
    return _driven(scene, share * scene.schedule.current_A)


def _driven(scene: Scene, current_A: Array) -> Scene:
    return replace(scene, schedule=replace(scene.schedule, current_A=current_A), current_A=current_A)


# ------------------------------------------------------------------------------- supply and rows


def _limit(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The share `size` of the largest current is beyond what the supply can give."""
    del rng
    limit_A = (1.0 - size) * np.abs(scene.current_A).max()
    delivered_A = np.clip(scene.current_A, -limit_A, limit_A)
    return replace(scene, current_A=delivered_A), Truth("coil1", (Known("limit_A", limit_A, "A"),))


def _sinking_limit(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """What the supply can give sinks as the resistance of the coil grows: warm, the share `size` of the largest current is missing."""
    del rng
    limit_A = np.abs(scene.current_A).max() / (1.0 + size * scene.schedule.coil_warming)
    return replace(scene, current_A=np.clip(scene.current_A, -limit_A, limit_A)), Truth("coil1", ())


def _stale_pose(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """In each third to tenth row the arm had not told the new pose yet; in some of these, at least, it had moved."""
    place_m, told_m = scene.displacement_m, scene.displacement_m.copy()
    while size and (told_m == place_m).all():
        step = int(rng.integers(3, 11))
        rows = np.arange(int(rng.integers(1, step + 1)), len(place_m), step)
        told_m[rows] = place_m[rows - 1]
    return replace(scene, displacement_m=told_m), Truth("arm1", ())


def _stale_reading(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """In each third to tenth row a sensor had no new reading when it was asked."""
    field_T, step = scene.readings_T.copy(), int(rng.integers(3, 11))
    for sensor in range(len(scene.schedule.sensors)):
        own = np.flatnonzero(scene.schedule.sensor == sensor)
        number = np.arange(int(rng.integers(1, step + 1)), len(own), step)
        field_T[own[number]] = scene.readings_T[own[number - 1]] if size else field_T[own[number]]
    return replace(scene, field_T=field_T), Truth("hall", ())


def _unsigned_currents(scene: Scene, size: float, rng: np.random.Generator) -> tuple[Scene, Truth]:
    """The size of the current is written down."""
    del rng
    current_A = np.abs(scene.current_A) if size else scene.current_A
    return replace(scene, current_A=current_A), Truth("coil1", ())


KINDS: Mapping[str, Cause] = {
    "current_limit": Cause("current_limit", Stage.SUPPLY, "1", 0.5, _limit),
    "sinking_limit": Cause("sinking_limit", Stage.SUPPLY, "1", 0.5, _sinking_limit),
    "stale_pose": Cause("stale_pose", Stage.RECORD, "1", 1.0, _stale_pose, is_discrete=True),
    "stale_reading": Cause("stale_reading", Stage.READOUT, "1", 1.0, _stale_reading, is_discrete=True),
    "unsigned_currents": Cause(
        "unsigned_currents", Stage.RECORD, "1", 1.0, _unsigned_currents, is_discrete=True
    ),
}


# ------------------------------------------------------------------------------- frames


def _in_another_frame(rng: np.random.Generator, sigma: float) -> Reported:
    """Software has turned each reading by the pose of the flange: into the axes of the base, or on into those of the room."""
    scene = draw_ideal("paper", rng)
    n = len(scene.schedule)
    flange = Rotation.from_rotvec(rng.uniform(-LARGEST_TURN_RAD, LARGEST_TURN_RAD, (n, 3)))
    base = (
        Rotation.from_rotvec([0.0, 0.0, rng.uniform(0.5, 2.5)]) if rng.random() < 0.5 else Rotation.identity()
    )
    places_m = scene.displacement_m * [1.0, 1.0, 0.6]  # the sensor moves instead of the coil
    scene = replace(
        scene,
        displacement_m=np.zeros((n, 3)),
        sensor_position_m=places_m,
        world_from_sensor=(base * flange).as_matrix(),
    )
    current_A = scene.current_A * rng.choice((-1.0, 0.5, 1.0), n)
    into = flange if rng.random() < 0.5 else base * flange

    def made(share: float) -> tuple[Scene, Record]:
        weaker = _driven(scene, share * current_A).measured()
        return weaker, Record(weaker.current_A, weaker.displacement_m, into.apply(weaker.readings_T), ())

    def visible(share: float) -> float:
        weaker, turned = made(share)
        effect = whiten(weaker, turned.field_T - weaker.readings_T)
        return float(np.linalg.norm(Adjustable.of(weaker, PRIOR_SD).cleared(effect)))

    share = _where(visible, sigma, 1.0)
    scene, turned = made(share)
    noise_T = scene.sigma_T * rng.normal(size=(n, 3))
    right, wrong = (replace(turned, field_T=of_T + noise_T) for of_T in (scene.readings_T, turned.field_T))
    session = CarriedSession(scene, wrong, base, base.inv().apply(places_m), flange)
    return Reported(session, replace(session, made=right), visible(share), 0.0, np.zeros(0, dtype=np.int64))


_HEADER = (
    "t_s,coil1_current_A,arm1_x_m,arm1_y_m,arm1_z_m,arm1_rx_rad,arm1_ry_rad,arm1_rz_rad,Bx_T,By_T,Bz_T,set"
)
_RIG = """schema_version: 1
name: a probe that is turned
movers:
  arm1: {{motion: pose, world_from_base: {{{base}}}}}
coils:
  coil1:
    radius_mm: {{value: 48, prior: {{normal: {{mean: 48, sd: 3}}}}}}
    wire_radius_mm: {{value: 0.46, prior: {{normal: {{mean: 0.46, sd: 0.03, lower: 0.2}}}}}}
    axial_loops: {{value: 45, prior: {{normal: {{mean: 45, sd: 3, lower: 1}}}}}}
    radial_loops: {{value: 22, prior: {{normal: {{mean: 22, sd: 3, lower: 1}}}}}}
    world_from_coil:
      x_mm: {{prior: {{normal: {{mean: 0, sd: 3}}}}}}
      y_mm: {{prior: {{normal: {{mean: 0, sd: 3}}}}}}
      z_mm: {{prior: {{normal: {{mean: {z_mm:.6f}, sd: 3}}}}}}
      tilt_x_deg: {{prior: {{normal: {{mean: 0, sd: 2}}}}}}
      tilt_y_deg: {{prior: {{normal: {{mean: 0, sd: 2}}}}}}
sensors:
  hall:
    carried_by: arm1
    noise_uT: {{prior: {{log_normal: {{median: 20, relative_sd: 0.5}}}}}}
    flange_from_sensor: {{}}
"""
