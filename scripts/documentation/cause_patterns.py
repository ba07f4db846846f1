"""What each cause does to the readings of an ordinary session, and what a calibration that does not know of it leaves over."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from estimator.diagnosis.fitting import Fit, fit_rig
from estimator.diagnosis.hypotheses.candidates import Candidate, candidates, causes_of
from estimator.diagnosis.next_readings.resolution import smallest_visible
from estimator.effects import EFFECTS
from estimator.effects.base import Effect, Quantity
from estimator.effects.circumstances import Circumstances
from estimator.effects.stages import NoiseEffect
from estimator.errors import InvalidInput
from estimator.model.hide import with_hidden
from estimator.model.measurement_model import MeasurementModel
from estimator.model.simulate import perfect_readings, simulate
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.read import rig_from_text

NOISE_T = 20e-6
ALIKE = 0.95  # cosine from which two causes count as alike
MOST_ALIKE = 6
HALF_WAY_H = 0.2  # about half of each session
FOR_A_WHILE = {"since_h": 0.5 * HALF_WAY_H, "until_h": HALF_WAY_H}
ONE_COIL = """
schema_version: 1
name: a coil on a stage, and a sensor that stands still
movers:
  stage: {motion: displacement}
coils:
  coil1:
    carried_by: stage
    radius_mm: {prior: {normal: {mean: 51, sd: 3}}}
    wire_radius_mm: {prior: {normal: {mean: 0.49, sd: 0.03, lower: 0.2}}}
    axial_loops: {prior: {normal: {mean: 48, sd: 3, lower: 1}}}
    radial_loops: {prior: {normal: {mean: 25, sd: 3, lower: 1}}}
    world_from_coil0:
      x_mm: {prior: {normal: {mean: 0, sd: 3}}}
      y_mm: {prior: {normal: {mean: 0, sd: 3}}}
      z_mm: {prior: {normal: {mean: -40, sd: 3}}}
      tilt_x_deg: {prior: {normal: {mean: 0, sd: 2}}}
      tilt_y_deg: {prior: {normal: {mean: 0, sd: 2}}}
sensors:
  hall: {noise_uT: 20}
"""
TWO_COILS = """
schema_version: 1
name: two coils, one of them on an arm, and two sensors
movers:
  stage: {motion: displacement}
  arm: {motion: UR3e, world_from_base: {x_mm: 415, y_mm: -131, z_mm: -481, rz_deg: 180}}
coils:
  coil1:
    carried_by: stage
    radius_mm: {prior: {normal: {mean: 40, sd: 1}}}
    wire_radius_mm: 0.5
    axial_loops: 30
    radial_loops: 10
    superconducting: true
    world_from_coil0:
      {x_mm: &place {prior: {normal: {mean: 0, sd: 2}}}, y_mm: *place, z_mm: {prior: {normal: {mean: -90, sd: 2}}},
      tilt_x_deg: *place, tilt_y_deg: *place}
  coil2:
    carried_by: arm
    radius_mm: {prior: {normal: {mean: 40, sd: 1}}}
    wire_radius_mm: 0.5
    axial_loops: 30
    radial_loops: 10
    flange_from_coil:
      {x_mm: *place, y_mm: *place, z_mm: {prior: {normal: {mean: 70, sd: 2}}}, tilt_x_deg: *place, tilt_y_deg: *place}
sensors:
  hall: {noise_uT: 20}
  other: {noise_uT: 20, world_from_sensor: {y_mm: 15, rx_deg: 90}}
"""
SIDES = """
schema_version: 1
name: a coil with straight sides on a stage, and a sensor that stands still
movers:
  stage: {motion: displacement}
coils:
  coil1:
    model: racetrack
    carried_by: stage
    inner_side_x_mm: 90
    inner_side_y_mm: 60
    inner_corner_radius_mm: 10
    wire_radius_mm: 0.5
    axial_loops: 20
    radial_loops: 8
    world_from_coil0:
      {x_mm: &place {prior: {normal: {mean: 0, sd: 3}}}, y_mm: *place, z_mm: {prior: {normal: {mean: -40, sd: 3}}},
      tilt_x_deg: &turn {prior: {normal: {mean: 0, sd: 2}}}, tilt_y_deg: *turn}
sensors:
  hall: {noise_uT: 20}
"""
MOVED_SENSOR = """
schema_version: 1
name: a coil that stands still, and a sensor on a stage
movers:
  stage: {motion: displacement}
coils:
  coil1:
    radius_mm: {prior: {normal: {mean: 51, sd: 3}}}
    wire_radius_mm: {prior: {normal: {mean: 0.49, sd: 0.03, lower: 0.2}}}
    axial_loops: {prior: {normal: {mean: 48, sd: 3, lower: 1}}}
    radial_loops: {prior: {normal: {mean: 25, sd: 3, lower: 1}}}
sensors:
  hall:
    carried_by: stage
    noise_uT: 20
    world_from_sensor0:
      {x_mm: &place {prior: {normal: {mean: 0, sd: 3}}}, y_mm: *place, z_mm: {prior: {normal: {mean: 40, sd: 3}}},
      tilt_x_deg: &turn {prior: {normal: {mean: 0, sd: 2}}}, tilt_y_deg: *turn}
"""
TURNED_SENSOR = """
schema_version: 1
name: a coil that stands still, and a sensor that a stage carries and turns
movers:
  stage:
    motion: pose
    world_from_base:
      {x_mm: &place {prior: {normal: {mean: 0, sd: 3}}}, y_mm: *place, z_mm: {prior: {normal: {mean: 40, sd: 3}}}}
coils:
  coil1:
    radius_mm: {prior: {normal: {mean: 51, sd: 3}}}
    wire_radius_mm: {prior: {normal: {mean: 0.49, sd: 0.03, lower: 0.2}}}
    axial_loops: {prior: {normal: {mean: 48, sd: 3, lower: 1}}}
    radial_loops: {prior: {normal: {mean: 25, sd: 3, lower: 1}}}
sensors:
  hall: {carried_by: stage, noise_uT: 20}
"""
# Sizes of causes that are there or not, or whose prior does not say where they would be.
SIZES: dict[str, dict[str, float]] = {
    "axes_swapped": {"x_reads": 2.0, "y_reads": -1.0},
    "axes_swapped_since": {"x_reads": 2.0, "y_reads": -1.0, "since_h": HALF_WAY_H},
    "coils_exchanged_since": {"later_by": 1.0, "since_h": HALF_WAY_H},
    "current_sign": {"sign": -1.0},
    "current_sign_since": {"sign": -1.0, "since_h": HALF_WAY_H},
    "current_sign_spell": {"sign": -1.0, **FOR_A_WHILE},
    "current_spell": {"step": 0.02, **FOR_A_WHILE},
    "background_spell": {"x_T": 50e-6, **FOR_A_WHILE},
    "mover_spell": {"x_m": 500e-6, **FOR_A_WHILE},
    "gain_spell": {"x": 0.01, **FOR_A_WHILE},
    "offset_spell": {"x_T": 50e-6, **FOR_A_WHILE},
    "displacement_frame": {"rz_rad": math.pi / 2.0, "rx_rad": 0.0, "ry_rad": 0.0},
    "left_handed": {"y_sign": -1.0},
    "pierced_plate": {"strength": 0.8, "axis": 2.0, "z_m": -0.01, "radius_m": 0.03},
    "pose_frame": {"rz_rad": math.pi / 2.0, "rx_rad": 0.0, "ry_rad": 0.0},
    "position_unit": {"x_factor": 10.0},
    "positions_swapped": {"x_reads": 2.0, "y_reads": 1.0},
    "range_clipping": {"limit_T": 0.006},
    "current_limit": {"limit_A": 2.0},
    "field_frame": {"axes": 2.0},
    "rotation_convention": {"convention": 1.0},
    "rows_shifted": {"rows": 1.0},
    "rows_shifted_since": {"rows": 1.0, "since_h": HALF_WAY_H},
    "sensor_lag": {"tau_s": 10.0},
    "channel_crosstalk": {"share": 0.05},
    "lead_wire": {"gap_m": 0.01, "length_m": 0.2},
    "unit_error": {"field_factor": 1.1},
}
# Causes that act on another one, which is there before and after.
COMPANIONS: dict[str, dict[str, float]] = {
    "core_remanence": {
        "cross_magnetisation[coil1].strength": 0.9,
        "cross_magnetisation[coil1].radius_m": 0.008,
        "cross_magnetisation[coil1].length_m": 0.03,
    }
}


@dataclass(frozen=True)
class Clean:
    """A session without any flaw."""

    rig: Rig
    observations: Observations


@dataclass(frozen=True)
class Ground(Clean):
    """Its fit too, and what each cause would do to it."""

    fit: Fit
    pool: Sequence[Candidate]


@dataclass(frozen=True)
class Pattern:
    """What one cause does.

    Attributes:
        cause: Name and place.
        given: Sizes that were set, by quantity; of a cause without quantities, 1.
        key, unit, size: The first of them.
        change_T: Change of the readings.
        left_T: The part that a calibration cannot follow; None where that is not linear.
        smallest: Smallest visible size of each quantity.
        alike: Causes that could be taken for it, with the cosine between what they leave.
    """

    cause: Cause
    given: dict[str, float]
    key: str
    unit: str
    size: float
    ground: Ground
    change_T: Float[np.ndarray, "reading 3"]
    left_T: Float[np.ndarray, "reading 3"] | None
    smallest: dict[str, float]
    alike: dict[str, float]


def sessions() -> tuple[Clean, ...]:
    """The sessions that causes are shown in; the first in which a cause can be is taken."""
    texts = (ONE_COIL, TWO_COILS, SIDES, MOVED_SENSOR, TURNED_SENSOR)
    return tuple(_session(rig_from_text(text)) for text in texts)


def grounds() -> tuple[Ground, ...]:
    """The same with their fits."""
    return tuple(_ground(session) for session in sessions())


def place_that_shows(effect: Effect, sessions: Sequence[Clean]) -> tuple[int, str]:
    """Index of the first session that shows a cause, and the place of the cause there.

    Raises:
        InvalidInput: None of them does.
    """
    for index, session in enumerate(sessions):
        for place in effect.places(session.rig):
            change_T = _change_T(effect, _hidden(effect, Cause(effect.name, place), session), session)
            if np.abs(change_T).max() > 1e-9:
                return index, place
    raise InvalidInput(
        f"{effect.name} must show in one of the sessions of the documentation; it shows in none"
    )


def pattern(name: str, grounds: Sequence[Ground]) -> Pattern:
    """The pattern of a cause in the first session that shows it.

    Raises:
        InvalidInput: None of them does.
    """
    effect = EFFECTS[name]
    index, place = place_that_shows(effect, grounds)
    return _pattern(effect, Cause(name, place), grounds[index])


def _session(rig: Rig) -> Clean:
    observations = _observations(rig)
    return Clean(rig, observations.with_field(perfect_readings(rig, observations)))


def _ground(clean: Clean) -> Ground:
    rig, observations = clean.rig, clean.observations
    fit = fit_rig(rig, observations, rig.nominal_values(), MeasurementModel.build(rig, observations).rules)
    return Ground(rig, observations, fit, candidates(fit, causes_of(rig, fit)))


def _observations(rig: Rig) -> Observations:
    """Twenty-four places in random order, both signs of the current and none, a morning that warms the room, three parts."""
    rng = np.random.default_rng(1)
    x, y, z = np.meshgrid(np.linspace(-50, 50, 4), np.linspace(-50, 50, 3), [-20, 20], indexing="ij")
    places_m = rng.permutation(np.stack((x, y, z), -1).reshape(-1, 3)) * 1e-3
    currents_A = np.array([[3.0, 0.0], [-3.0, 1.0], [1.5, 3.0], [0.0, 0.0]])[:, : len(rig.coils)]
    n = len(places_m) * len(currents_A)
    displacement = np.zeros((n, 6))
    displacement[:, :3] = places_m.repeat(len(currents_A), axis=0)
    joints = np.radians([0.0, -90.0, -90.0, 0.0, 90.0, 0.0]) + rng.uniform(-0.03, 0.03, (n, 6))
    if len(rig.movers) > 1 or rig.movers[0].motion is MotionKind.POSE:  # turns too, for what needs turns
        displacement[:, 3:] = rng.uniform(-0.2, 0.2, (n, 3))
    columns = {"stage": torch.from_numpy(displacement), "arm": torch.from_numpy(joints)}
    time_s = 15.0 * torch.arange(n, dtype=torch.float64)
    warmer_K = torch.linspace(0.0, 3.0, n, dtype=torch.float64) ** 2 / 3.0
    warm = [*(sensor.name for sensor in rig.sensors), *(coil.name for coil in rig.coils)]
    return Observations.of(
        torch.from_numpy(np.tile(currents_A, (len(places_m), 1))),
        {mover.name: columns[mover.name] for mover in rig.movers},
        torch.zeros(n, 3, dtype=torch.float64),
        time_s=time_s,
        sensor=torch.arange(n) // 2 % len(rig.sensors),
        temperature_C=dict.fromkeys(warm, 20.0 + warmer_K),
        recorded_segment=torch.arange(n) // math.ceil(n / 3),
    )


def _pattern(effect: Effect, cause: Cause, ground: Ground) -> Pattern:
    quantities = effect.quantities(Circumstances(ground.rig, ground.observations).extent)
    given = _given(effect, ground)
    key = next(iter(given), "")
    size = given.get(key, 1.0)
    change_T = _change_T(effect, _hidden(effect, cause, ground), ground)
    left_T = None
    alike: dict[str, float] = {}
    if not (isinstance(effect, NoiseEffect) or effect.is_record_mistake):
        left = ground.fit.projector.rest(torch.from_numpy(change_T).reshape(-1) / NOISE_T)
        left_T = left.reshape(-1, 3).numpy() * NOISE_T
        alike = _alike(left, effect.name, ground)
    own = [candidate for candidate in ground.pool if candidate.cause == cause]
    smallest = {visible.key: visible.size for visible in smallest_visible(ground.fit, own)}
    unit = next((q.unit for q in quantities if q.key == key), "1")
    return Pattern(cause, given or {"": 1.0}, key, unit, size, ground, change_T, left_T, smallest, alike)


def _given(effect: Effect, session: Clean) -> dict[str, float]:
    """Sizes by quantity; of several numbers alike the first alone."""
    if effect.name in SIZES:
        return SIZES[effect.name]
    quantities = effect.quantities(Circumstances(session.rig, session.observations).extent)
    first = next((quantity for quantity in quantities if not quantity.is_shape), None)
    return {} if first is None else {first.key: _size(first)}


def _hidden(effect: Effect, cause: Cause, session: Clean) -> dict[str, float]:
    """What is hidden in the session, by `cause[place].quantity`; of a cause without quantities, 1."""
    given = _given(effect, session)
    return {f"{cause.label}.{key}": value for key, value in given.items()} or {cause.label: 1.0}


def _change_T(effect: Effect, hidden: dict[str, float], session: Clean) -> Float[np.ndarray, "reading 3"]:
    """What a cause changes in the readings."""
    if isinstance(effect, NoiseEffect):
        return _scatter(session, hidden)
    before = COMPANIONS.get(effect.name, {})
    return _readings_T(session, before | hidden) - _readings_T(session, before)


def _readings_T(ground: Clean, hidden: dict[str, float]) -> Float[np.ndarray, "reading 3"]:
    return perfect_readings(with_hidden(ground.rig, ground.observations, hidden), ground.observations).numpy()


def _size(quantity: Quantity) -> float:
    """A natural size: where the prior has its middle, or one standard deviation from the null."""
    prior, null = quantity.prior, quantity.null
    return prior.centre if abs(prior.centre - null) > 0.2 * prior.sd else min(null + prior.sd, prior.upper)


def _scatter(ground: Clean, hidden: dict[str, float]) -> Float[np.ndarray, "reading 3"]:
    """Noisy readings with a cause of scatter, less perfect ones."""
    poses = tuple(
        {name: columns[i].numpy() for name, columns in ground.observations.motion.items()}
        for i in range(0, len(ground.observations.time_s), 4)
    )
    plan = Plan(
        "the same places", poses, (), ({"coil1": 3.0}, {"coil1": -3.0}, {"coil1": 1.5}, {}), "raster", 1, 1.0
    )
    noisy = simulate(ground.rig, plan, {}, 1, hidden)
    return (noisy.field_sensor_T - perfect_readings(ground.rig, replace(noisy))).numpy()


def _alike(left: torch.Tensor, name: str, ground: Ground) -> dict[str, float]:
    """Causes whose columns follow what this one leaves."""
    norm = float(left.norm())
    if norm < 1.0:  # nothing to be taken for something else: the calibration follows all of it
        return {}
    cosines: dict[str, float] = {}
    for candidate in ground.pool:
        columns = ground.fit.projector.rest(candidate.columns)
        columns = columns[:, columns.norm(dim=0) > 1e-9 * norm]
        if candidate.cause.name == name or not columns.shape[1]:
            continue
        basis, sizes, _ = torch.linalg.svd(columns / columns.norm(dim=0), full_matrices=False)
        along = basis[:, sizes > 1e-6 * sizes[0]].T @ left
        cosines[candidate.cause.name] = max(
            cosines.get(candidate.cause.name, 0.0), float(along.norm()) / norm
        )
    best = sorted(cosines.items(), key=lambda item: -item[1])
    return {other: cosine for other, cosine in best if cosine >= ALIKE}
