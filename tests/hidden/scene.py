"""The true state behind every reading of one session, and the field that follows from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.hidden.coil import CoilField, Winding, blocks_of, circular_field
from tests.hidden.protocols import Array, Schedule

Source = Callable[["Scene", Array], Array]  # world points, one per reading -> field there in the world


@dataclass(frozen=True)
class Arm:
    """What carries the coil where the laboratory writes down poses of the flange: base_from_flange, from joint angles or as such.

    Attributes:
        base_rotation, base_position_m: world_from_base.
        mount_m: Place of the coil's frame on the flange.
    """

    base_rotation: Array
    base_position_m: Array
    mount_m: Array


@dataclass(frozen=True)
class Scene:
    """The true state behind every reading.

    Attributes:
        coil_position_m, coil_rotation: world_from_coil at the reference; with an arm, that of `Arm` and mount counts instead.
        flange_from_coil: Rotation of the coil in its mount.
        noise_T: Per sensor, of each component.
        current_A: Delivered to coil1.
        displacement_m: True displacement of coil1 in the end-effector frame; with an arm, place of the flange in its base.
        sensor_position_m, world_from_sensor: True pose of the reading's sensor.
        element_offset_m: Place of the elements for x, y, z in the sensor's frame; reading by element by xyz.
        coil_field: Of coil1 per ampere, in its frame.
        sources: What else makes a field.
        field_T: Components at the sensor, then as the sensor shows them.
        arm: None where displacements are written down.
        turn: Rotation of the flange, since the reference or, with an arm, in its base; None where it never turns.
    """

    schedule: Schedule
    winding: Winding
    coil_position_m: Array
    coil_rotation: Array
    noise_T: Array
    flange_from_coil: Array
    current_A: Array
    displacement_m: Array
    sensor_position_m: Array
    world_from_sensor: Array
    element_offset_m: Array
    coil_field: CoilField
    sources: tuple[Source, ...] = ()
    field_T: Array | None = None
    arm: Arm | None = None
    turn: Array | None = None

    @property
    def sigma_T(self) -> Array:
        """Noise of each reading's components, as a column."""
        return np.asarray(self.noise_T[self.schedule.sensor][:, None])

    @property
    def readings_T(self) -> Array:
        """What the sensors show; stages before the sensor's have none."""
        assert self.field_T is not None
        return self.field_T

    @property
    def coil_offset_m(self) -> Array:
        """Displacement of the coil along its own axes."""
        return self.displacement_m @ self.flange_from_coil

    def coil_origin_m(self) -> Array:
        """Where the front face stands in the world, per reading."""
        if self.turn is not None:
            return self.coil_pose(self.turn)[1]
        return self.coil_position_m + self.coil_offset_m @ self.coil_rotation.T

    def coil_pose(self, turn: Array) -> tuple[Array, Array]:
        """world_from_coil of every reading, rotation and place, where the flange turns."""
        if self.arm is None:  # world_from_coil0 coil_from_flange (displacement, turn) flange_from_coil
            to_world = self.coil_rotation @ self.flange_from_coil.T
            return (
                to_world @ turn @ self.flange_from_coil,
                self.coil_position_m + self.displacement_m @ to_world.T,
            )
        to_world, place_m = self.arm.base_rotation, self.displacement_m + turn @ self.arm.mount_m
        return to_world @ turn @ self.flange_from_coil, self.arm.base_position_m + place_m @ to_world.T

    def in_coil_frame(self, points_m: Array) -> Array:
        """World points, one per reading."""
        if self.turn is None:
            return (points_m - self.coil_position_m) @ self.coil_rotation - self.coil_offset_m
        rotation, origin_m = self.coil_pose(self.turn)
        return np.asarray(np.einsum("nij,ni->nj", rotation, points_m - origin_m))

    def from_coil_axes(self, vectors: Array) -> Array:
        """Vectors along the coil's axes, one per reading, in the world."""
        if self.turn is None:
            return np.asarray(vectors @ self.coil_rotation.T)
        return np.asarray(np.einsum("nij,nj->ni", self.coil_pose(self.turn)[0], vectors))

    def coil_field_at(self, points_m: Array) -> Array:
        """Field of coil1 alone at world points, one per reading.

        References: Osinde et al., eq 18-22: p = -flange_from_coil^T dt - world_from_coil0^T t.
        """
        return np.asarray(
            self.current_A[:, None] * self.from_coil_axes(self.coil_field(self.in_coil_frame(points_m)))
        )

    def field_at(self, points_m: Array) -> Array:
        """Field of everything at world points, one per reading."""
        return self.coil_field_at(points_m) + sum(
            (s(self, points_m) for s in self.sources), np.zeros_like(points_m)
        )

    def measured(self) -> Scene:
        """With the field at the elements, along the elements."""
        if not self.element_offset_m.any():
            world_T = self.field_at(self.sensor_position_m)
            return replace(self, field_T=np.einsum("nij,ni->nj", self.world_from_sensor, world_T))
        columns = []
        for k in range(3):
            shift_m = np.einsum("nij,nj->ni", self.world_from_sensor, self.element_offset_m[:, k])
            world_T = self.field_at(self.sensor_position_m + shift_m)
            columns.append(np.einsum("ni,ni->n", self.world_from_sensor[:, :, k], world_T))
        return replace(self, field_T=np.stack(columns, axis=1))


def ideal_scene(
    schedule: Schedule, winding: Winding, coil_position_m: Array, tilt_rad: Array, noise_T: Array
) -> Scene:
    """A scene without flaw: commands are obeyed, the sensors stand where the rig says.

    Args:
        tilt_rad: Rotation vector of world_from_coil0; its third entry, the spin, is 0 in every rig of these tests.
    """
    n = len(schedule)
    turns = np.array([Rotation.from_rotvec(s.rotation_vector_rad).as_matrix() for s in schedule.sensors])
    places_m = np.array([s.position_m for s in schedule.sensors])
    return Scene(
        schedule,
        winding,
        coil_position_m,
        Rotation.from_rotvec(tilt_rad).as_matrix(),
        noise_T,
        np.eye(3),
        schedule.current_A,
        schedule.displacement_m,
        places_m[schedule.sensor],
        turns[schedule.sensor],
        np.zeros((n, 3, 3)),
        circular_field(blocks_of(winding)),
    )
