"""The field at a sensor of a running, simulated rig: the model at the currents and poses of the moment, with noise and hidden causes.

A simulator calls it in its own process for each sample (`drivers.simulated`), so it is pickled, and reads nothing but a snapshot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np

from estimator.effects import effect_of
from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.geometry.motion import motion_reached
from estimator.model.hide import cause_of, full_names, with_hidden, with_truth
from estimator.model.simulate import perfect_readings
from estimator.readings.observations import Observations
from estimator.rig.bodies import DisplacementFrame, MotionKind, Mover
from estimator.rig.rig import Rig
from estimator.tensors import torch
from estimator.units import ICE_POINT_K

TIME_STEP_S = 1.0  # to which drifts are followed
TEMPERATURE_STEP_K = 0.05
REFERENCE_C = 22.0  # of the simulated room, in which coils and sensors are what the rig file says
SPREAD_M = 0.05  # of the poses that stand for a session, where a cause asks for its extent

Flange = tuple[tuple[float, float, float], tuple[float, float, float]]


@runtime_checkable
class _Pose(Protocol):
    @property
    def position_m(self) -> tuple[float, float, float]: ...
    @property
    def rotation_vector_rad(self) -> tuple[float, float, float]: ...


@runtime_checkable
class Moment(Protocol):
    """The state of a simulated world; a `drivers.simulated.world.Snapshot` is one."""

    @property
    def time_s(self) -> float:
        """Time since the world began, in s."""
        ...

    @property
    def currents_A(self) -> tuple[float, ...]:
        """Current in each coil that has a supply, in A."""
        ...

    @property
    def base_from_flange(self) -> tuple[_Pose, ...]:
        """Pose of the flange of each arm in the frame of its base."""
        ...

    @property
    def coil_temperatures_K(self) -> tuple[float, ...]:
        """Temperature of each coil that has a supply, in K."""
        ...

    @property
    def room_temperature_K(self) -> float:
        """Temperature of everything but the coils, in K."""
        ...


@dataclass
class SimulatedField:
    """Field along the axes of one sensor.

    Attributes:
        rig: The truth, with hidden causes among its effects; its movers report poses or displacements (`simulated_rig`).
        sensor: Name of the sensor.
        coils: Names of the coils, in the order of the world's currents; others are off.
        homes: Pose of the flange at the start per mover, in the order of the world's arms; displacements count from there.
        seed: Of the noise.
    """

    rig: Rig
    sensor: str
    coils: tuple[str, ...]
    homes: Mapping[str, Flange]
    seed: int
    _last: tuple[tuple[object, ...], torch.Tensor] | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._index = [sensor.name for sensor in self.rig.sensors].index(self.sensor)
        self._noise_T = self.rig.nominal_values()[f"{self.sensor}.noise_T"]

    def __call__(self, moment: Moment) -> tuple[float, float, float]:
        """Field in tesla; zero inside a winding, where no formula holds."""
        steps = [
            round(t_K / TEMPERATURE_STEP_K)
            for t_K in (*moment.coil_temperatures_K, moment.room_temperature_K)
        ]
        key = (math.floor(moment.time_s / TIME_STEP_S), moment.currents_A, moment.base_from_flange, *steps)
        if self._last is None or self._last[0] != key:
            self._last = (key, self._perfect_T(moment))
        x_T, y_T, z_T = (self._last[1].numpy() + self._rng.normal(size=3) * self._noise_T).tolist()
        return x_T, y_T, z_T

    def _perfect_T(self, moment: Moment) -> torch.Tensor:
        try:
            # For two readings the full sum costs less than the search for a rule that is shorter.
            return perfect_readings(self.rig, self._observations(moment), tolerance=0.0)[1]
        except InvalidInput:
            return torch.zeros(3, dtype=torch.float64)

    def _observations(self, moment: Moment) -> Observations:
        """Two readings, the first when the world began: what drifts has drifted since then."""
        currents_A = dict(zip(self.coils, moment.currents_A, strict=True))
        row_A = [currents_A.get(coil.name, 0.0) for coil in self.rig.coils]
        motion = {}
        for mover, pose in zip(self.homes, moment.base_from_flange, strict=False):
            here = flange((pose.position_m, pose.rotation_vector_rad))
            nothing = torch.zeros(1, 6, dtype=torch.float64)
            reached = motion_reached(self.rig.mover(mover), here, flange(self.homes[mover]), nothing)
            motion[mover] = reached.expand(2, 6)
        time_s = math.floor(moment.time_s / TIME_STEP_S) * TIME_STEP_S
        readings = _observations(self.rig, [0.0, time_s], self._index, row_A, motion)
        return replace(readings, temperature_C=self._temperature_C(moment))

    def _temperature_C(self, moment: Moment) -> dict[str, torch.Tensor]:
        """Temperatures of both readings. Causes count a coil's from the coolest of a session, a sensor's from the mean."""
        room_C = moment.room_temperature_K - ICE_POINT_K
        pairs = {self.sensor: (2.0 * REFERENCE_C - room_C, room_C)}
        for name, coil_K in zip(self.coils, moment.coil_temperatures_K, strict=True):
            pairs[name] = (REFERENCE_C, max(REFERENCE_C, coil_K - ICE_POINT_K))
        return {name: torch.tensor(pair, dtype=torch.float64) for name, pair in pairs.items()}


def simulated_rig(rig: Rig, truth: Mapping[str, float], hidden: Mapping[str, float]) -> Rig:
    """The rig that a simulated world is made of.

    Args:
        rig: As its file describes it.
        truth: Values that replace its own.
        hidden: Causes that the file knows nothing of (`estimator.model.hide`).
    Raises:
        InvalidInput: A value is impossible, or a cause is none that the field of a moment shows.
    """
    real = with_truth(rig, truth)
    for text in hidden:
        cause = cause_of(text, rig)
        key = next(iter(full_names(rig, {text: 0.0}))).removeprefix(f"{cause.label}.")
        reason = effect_of(cause.name).beyond_the_moment(key)
        if reason is not None:
            raise InvalidInput(
                f"a cause hidden in a running rig must show in the field of a moment; {cause.label}.{key} depends on {reason} "
                "(coilcal simulate can hide it)"
            )
    # A world knows poses, so movers report these: by the kinematics of the model, joint angles would say the same.
    real = replace(real, movers=tuple(_reporting_poses(mover) for mover in real.movers))
    return with_hidden(real, _typical(real), hidden)


def flange(pose: Flange) -> Transform:
    """A pose as it stands in plain numbers."""
    position_m, rotation_vector_rad = (torch.tensor([part], dtype=torch.float64) for part in pose)
    return Transform.from_pose(position_m, rotation_vector_rad)


def _reporting_poses(mover: Mover) -> Mover:
    if mover.motion is MotionKind.DISPLACEMENT:
        return replace(mover, displacement_frame=DisplacementFrame.END_EFFECTOR)
    return replace(mover, motion=MotionKind.POSE, own_table=None, own_ends=None)


def _typical(rig: Rig) -> Observations:
    """Poses some way apart with a current in all coils, as causes with shapes need them."""
    steps = torch.cat((torch.zeros(1, 3), SPREAD_M * torch.eye(3), -SPREAD_M * torch.eye(3))).double()
    motion = {mover.name: torch.cat((steps, torch.zeros(7, 3)), dim=1) for mover in rig.movers}
    return _observations(rig, [float(i) for i in range(7)], 0, [1.0] * len(rig.coils), motion)


def _observations(
    rig: Rig,
    time_s: Sequence[float],
    sensor: int,
    current_A: Sequence[float],
    motion: Mapping[str, torch.Tensor],
) -> Observations:
    n = len(time_s)
    at_rest = torch.zeros(n, 6, dtype=torch.float64)
    return Observations.of(
        torch.tensor([current_A] * n, dtype=torch.float64).reshape(n, len(rig.coils)),
        {mover.name: motion.get(mover.name, at_rest) for mover in rig.movers},
        time_s=torch.tensor(time_s, dtype=torch.float64),
        sensor=torch.full((n,), sensor),
    )
