"""From commanded currents and poses to predicted readings.

The measuring chain runs in one direction: current delivered to each coil -> pose of every coil and sensor -> field of the coils at the
sensor -> components in the sensor's frame. One call predicts a whole batch of parameter sets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.coordinates import Values
from estimator.errors import InvalidInput
from estimator.field.winding import (
    DEFAULT_TOLERANCE,
    Rule,
    Winding,
    choose_rule,
    distance_to_winding,
    winding_field_per_ampere,
)
from estimator.frames import Transform, rotation_from_vector
from estimator.kinematics import base_from_flange
from estimator.records import Observations
from estimator.rig import Body, Coil, DisplacementFrame, MotionKind, Mover, Rig


@dataclass(frozen=True)
class Chain:
    """The measuring chain of one rig over one set of readings.

    Readings that share a pose share its geometry: `place` maps each reading to a row of distinct poses, so that +I, -I and repeats at
    one place cost one field evaluation.

    Attributes:
        rig: What is modelled.
        current_A: Commanded current, reading by coil.
        place: Row of distinct poses that each reading stands at.
        sensor: Sensor of each distinct pose.
        flange: Per mover base_from_flange (or the displacement) of each distinct pose; one rotation for all where it is the same.
        powered: Per coil the distinct poses where it ever carries current.
        rules: Per coil the quadrature rule.
        is_compiled: Sum with compiled code, for long sampling; no derivatives then.
    """

    rig: Rig
    current_A: Float[Tensor, "reading coil"]
    place: Int[Tensor, " reading"]
    sensor: Int[Tensor, " place"]
    flange: dict[str, Transform]
    powered: dict[str, Int[Tensor, " rows"]]
    rules: dict[str, Rule]
    is_compiled: bool = False

    @classmethod
    def build(cls, rig: Rig, observations: Observations, tolerance: float = DEFAULT_TOLERANCE) -> Chain:
        """Set the chain up at the rig's nominal values.

        Raises:
            InvalidInput: A sensor would stand inside a winding.
        """
        motions = [observations.motion[mover.name] for mover in rig.movers]
        key = torch.cat([observations.sensor[:, None].to(torch.float64), *motions], dim=1)
        distinct, place = torch.unique(key, dim=0, return_inverse=True)
        flange = {
            mover.name: _sharing_rotation(base_from_motion(mover, distinct[:, 1 + 6 * i : 7 + 6 * i]))
            for i, mover in enumerate(rig.movers)
        }
        powered = {
            coil.name: place[observations.current_A[:, i] != 0.0].unique() for i, coil in enumerate(rig.coils)
        }
        sensor = distinct[:, 0].to(torch.int64)
        chain = cls(rig, observations.current_A, place, sensor, flange, powered, {})
        nominal = {k: torch.tensor(v, dtype=torch.float64) for k, v in rig.nominal_values().items()}
        return chain.with_rules(nominal, tolerance)

    def with_rules(self, values: Values, tolerance: float = DEFAULT_TOLERANCE) -> Chain:
        """The same chain with quadrature rules chosen at these values (no batch)."""
        rules = {}
        for coil in self.rig.coils:
            rows = self.powered[coil.name]
            if len(rows):
                points_m, _ = self.sensor_in_coil(coil, rows, values)
                winding = winding_of(coil, values)
                self._refuse_inside(coil, rows, points_m, winding)
                rules[coil.name] = choose_rule(winding, points_m, tolerance)
        return replace(self, rules=rules)

    def predict(self, values: Values) -> Float[Tensor, "*batch reading 3"]:
        """Field components each reading should show, in the frame of its sensor, in tesla.

        Args:
            values: Every number of the rig by name, from `Coordinates.values`; a batch where free.
        """
        total: Tensor | None = None
        for i, coil in enumerate(self.rig.coils):
            if coil.name not in self.rules:
                continue
            per_ampere = self._field_per_ampere(coil, values)
            gain = values[f"{coil.name}.current_gain"]
            delivered_A = gain[..., None] * self.current_A[:, i]
            field = delivered_A[..., None] * per_ampere[..., self.place, :]
            total = field if total is None else total + field
        if total is None:
            return torch.zeros((*self.current_A.shape[:1], 3), dtype=self.current_A.dtype)
        return self._gain(values)[..., None] * total

    def loop_evaluations(self) -> int:
        """Loop fields that one prediction of one parameter set costs."""
        return sum(len(self.powered[n]) * r.axial_nodes * r.radial_nodes for n, r in self.rules.items())

    def _gain(self, values: Values) -> Float[Tensor, "*batch reading"]:
        gains = torch.broadcast_tensors(*(values[f"{s.name}.gain"] for s in self.rig.sensors))
        return torch.stack(gains, dim=-1)[..., self.sensor[self.place]]

    def _field_per_ampere(self, coil: Coil, values: Values) -> Float[Tensor, "*batch place 3"]:
        rows = self.powered[coil.name]
        points_m, sensor_from_coil = self.sensor_in_coil(coil, rows, values)
        winding = winding_of(coil, values)
        field = winding_field_per_ampere(points_m, winding, self.rules[coil.name], self.is_compiled)
        field = (sensor_from_coil @ field[..., None])[..., 0]
        if len(rows) == len(self.sensor):
            return field
        full = torch.zeros((*field.shape[:-2], len(self.sensor), 3), dtype=field.dtype, device=field.device)
        return full.index_copy(-2, rows, field)

    def sensor_in_coil(
        self, coil: Coil, rows: Int[Tensor, " rows"], values: Values
    ) -> tuple[Float[Tensor, "*batch rows 3"], Float[Tensor, "*#batch #rows 3 3"]]:
        """Sensor position in the coil frame and the rotation sensor_from_coil, at distinct poses."""
        coil_from_world = self._world_from_body(coil, "coil", rows, values).inverse()
        world_from_sensor = self._world_from_sensor(rows, values)
        coil_from_sensor = coil_from_world @ world_from_sensor
        return coil_from_sensor.translation_m, coil_from_sensor.rotation.mT

    def _world_from_sensor(self, rows: Int[Tensor, " rows"], values: Values) -> Transform:
        which = self.sensor[rows]
        poses = [self._world_from_body(s, "sensor", rows, values) for s in self.rig.sensors]
        if len(poses) == 1:
            return poses[0]
        rotation, translation = poses[0].rotation, poses[0].translation_m
        for i, pose in enumerate(poses[1:], start=1):
            mine = which == i
            rotation = torch.where(mine[:, None, None], pose.rotation, rotation)
            translation = torch.where(mine[:, None], pose.translation_m, translation)
        return Transform(rotation, translation)

    def _world_from_body(
        self, body: Body, kind: str, rows: Int[Tensor, " rows"], values: Values
    ) -> Transform:
        flange = {
            name: Transform(
                whole.rotation if len(whole.rotation) == 1 else whole.rotation[rows],
                whole.translation_m[rows],
            )
            for name, whole in self.flange.items()
        }
        return world_from_body(self.rig, body, kind, flange, values)

    def _refuse_inside(self, coil: Coil, rows: Tensor, points_m: Tensor, winding: Winding) -> None:
        inside = (distance_to_winding(points_m, winding) <= 0.0).nonzero().flatten()
        if len(inside):
            reading = int(torch.isin(self.place, rows[inside]).nonzero().flatten()[0])
            raise InvalidInput(
                f"sensors must lie outside the winding of {coil.name}; at the rig's nominal values {len(inside)} of "
                f"{len(rows)} places do not, the first at reading {reading} (rig {self.rig.name!r})"
            )


def world_from_body(
    rig: Rig, body: Body, kind: str, flange: Mapping[str, Transform], values: Values
) -> Transform:
    """Pose of a coil or sensor, given where the movers stand.

    Args:
        rig: Names the mover that carries the body.
        body, kind: The body and its kind, `coil` or `sensor`.
        flange: Per mover base_from_flange, or the displacement in the end-effector frame (`base_from_motion`).
        values: Every number of the rig.
    References: Osinde et al., eq 14-22, with the frames of DESIGN section 2.
    """
    if body.carried_by is None:
        return pose_of(f"{body.name}.world_from_{kind}", values)
    mover = rig.mover(body.carried_by)
    flange_from_body = pose_of(f"{body.name}.flange_from_{kind}", values)
    if mover.motion is MotionKind.DISPLACEMENT:
        world_from_flange0 = pose_of(f"{body.name}.world_from_{kind}0", values) @ flange_from_body.inverse()
        return world_from_flange0 @ flange[mover.name] @ flange_from_body
    return pose_of(f"{mover.name}.world_from_base", values) @ flange[mover.name] @ flange_from_body


def winding_of(coil: Coil, values: Values) -> Winding:
    """The coil's winding at these values."""
    keys = ("radius_m", "axial_loops", "radial_loops", "axial_pitch_m", "radial_pitch_m")
    return Winding(*torch.broadcast_tensors(*(values[f"{coil.name}.{key}"] for key in keys)))


def pose_of(prefix: str, values: Values) -> Transform:
    """Transform of a pose block, with a row axis of 1 to broadcast over poses.

    The rotation is the rotation vector (rx, ry, rz) followed by the small rotation (tilt_x, tilt_y, spin) about the body's own axes, so
    that a coil's spin about its axis stays one parameter whatever its nominal direction.
    """

    def three(*keys: str) -> Tensor:
        return torch.stack(torch.broadcast_tensors(*(values[f"{prefix}.{key}"] for key in keys)), dim=-1)

    turn, own_turn = torch.broadcast_tensors(
        three("rx_rad", "ry_rad", "rz_rad"), three("tilt_x_rad", "tilt_y_rad", "spin_rad")
    )
    rotation, own = rotation_from_vector(torch.stack((turn, own_turn))).unbind()  # one call costs half of two
    translation_m = three("x_m", "y_m", "z_m")
    return Transform((rotation @ own)[..., None, :, :], translation_m[..., None, :])


def base_from_motion(mover: Mover, motion: Float[Tensor, "place 6"]) -> Transform:
    """Flange pose of a mover's readings: base_from_flange, or the displacement in the end-effector frame.

    References: Osinde et al., eq 18-22; a controller that reports displacements in its base frame needs base_from_flange(q0)^T first
        (DESIGN section 2).
    """
    if mover.motion in (MotionKind.UR3, MotionKind.UR3E):
        return base_from_flange(str(mover.motion), motion)
    pose = Transform.from_pose(motion[:, :3], motion[:, 3:])
    if mover.motion is MotionKind.DISPLACEMENT and mover.displacement_frame is DisplacementFrame.BASE:
        base_from_flange0 = rotation_from_vector(
            torch.tensor(mover.reference_rotation_rad, dtype=motion.dtype)
        )
        turned = base_from_flange0.mT @ pose.rotation @ base_from_flange0
        return Transform(turned, pose.translation_m @ base_from_flange0)
    return pose


def _sharing_rotation(poses: Transform) -> Transform:
    """The same poses; where all are turned alike, as under pure translations, the row axis of the rotation is 1.

    Matrix products over rows then happen once: a third of the time of a prediction that is short otherwise.
    """
    first = poses.rotation[:1]
    return Transform(first, poses.translation_m) if bool((poses.rotation == first).all()) else poses
