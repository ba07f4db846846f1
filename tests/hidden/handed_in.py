"""What a laboratory hands in: a rig file and a table of readings; and `truth.json`, which no diagnosis may read."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scipy.spatial.transform import Rotation

from tests.hidden.causes.surroundings import NEIGHBOUR, NEIGHBOUR_POSITION_M, neighbour_rotation_rad
from tests.hidden.flaw import Flaw, Record
from tests.hidden.protocols import Array, Schedule
from tests.hidden.scene import Scene
from tests.hidden.stated_rig import POSE, StatedRig

WINDING_KEYS = ("radius_m", "wire_radius_m", "axial_loops", "radial_loops")
POSE_KEYS = ("x_mm", "y_mm", "z_mm", "rx_rad", "ry_rad", "rz_rad")


@dataclass(frozen=True)
class Visible:
    """How visible a flaw is.

    Attributes:
        sigma: Beside the base model.
        unlike_sigma: Beside the base model and any one rival, which is another hidden cause; for a cause outside the library beside any
            two of all within. None for discrete flaws and noise.
    """

    sigma: float
    unlike_sigma: float | None


@dataclass(frozen=True)
class HiddenSession:
    """A session, and what is hidden in it.

    Attributes:
        scene: Without the flaws.
        visible: Visible size of each flaw.
        record: What the laboratory wrote down.
        unflawed: What it would have written down without the flaws, the same noise in it.
        has_neighbour: The rig has an idle coil2.
        rig: What the rig file states of arm and coil1; None is the file of the first study.
    """

    seed: int
    scene: Scene
    flaws: tuple[Flaw, ...]
    visible: tuple[Visible, ...]
    record: Record
    unflawed: Record
    has_neighbour: bool
    rig: StatedRig | None = None

    def without_flaws(self) -> HiddenSession:
        """The same session, noise included, in which nothing is wrong."""
        return replace(self, flaws=(), visible=(), record=self.unflawed)

    @property
    def schedule(self) -> Schedule:
        """What was commanded."""
        return self.scene.schedule

    def truth(self) -> dict[str, Any]:
        """Everything that is hidden, under coilcal's names where it has one."""
        values = {
            f"coil1.{key}": float(getattr(self.scene.winding, key)) for key in WINDING_KEYS
        } | self._true_pose()
        sensors = self.schedule.sensors
        values |= {f"{s.name}.noise_T": float(v) for s, v in zip(sensors, self.scene.noise_T, strict=True)}
        causes = [
            {
                "name": flaw.cause.name,
                "place": truth.place,
                "size": flaw.size,
                "size_unit": flaw.cause.unit,
                "visible_sigma": visible.sigma,
                "unlike_sigma": visible.unlike_sigma,
                "parameters": {p.name: {"value": float(p.value), "unit": p.unit} for p in truth.parameters},
            }
            for flaw, visible, truth in zip(self.flaws, self.visible, self.record.truths, strict=True)
        ]
        told = {"seed": self.seed, "protocol": self.schedule.protocol, "causes": causes, "values": values}
        return told if self.rig is None else told | {"motion": self.rig.motion, "is_tight": self.rig.is_tight}

    def _true_pose(self) -> dict[str, float]:
        """Where coil1 stands, in the numbers that the rig file leaves free."""
        scene = self.scene
        if self.rig is None or self.rig.base_rotation is None or scene.arm is None:
            return _pose("coil1.world_from_coil0", scene.coil_position_m, scene.coil_rotation, 5)
        base = _pose(
            "arm1.world_from_base",
            scene.arm.base_position_m,
            self.rig.base_rotation.T @ scene.arm.base_rotation,
            6,
        )
        return base | _pose("coil1.flange_from_coil", scene.arm.mount_m, scene.flange_from_coil, 6)

    def write(self, folder: Path) -> None:
        """Write `rig.yaml`, `readings.csv` and `truth.json`."""
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "rig.yaml").write_text(self.rig_text(), encoding="utf-8")
        (folder / "truth.json").write_text(json.dumps(self.truth(), indent=2) + "\n", encoding="utf-8")
        columns = self.columns()
        with (folder / "readings.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))

    def columns(self) -> dict[str, Sequence[object]]:
        """The readings' table, header to cells."""
        schedule, made = self.schedule, self.record
        columns: dict[str, Sequence[object]] = {
            "t_s": schedule.time_s.tolist(),
            "sensor": [schedule.sensors[i].name for i in schedule.sensor],
            "coil1_current_A": made.current_A.tolist(),
        }
        if self.has_neighbour:
            columns["coil2_current_A"] = [0.0] * len(schedule)
        columns |= _motion(schedule, made)
        columns |= {f"B{axis}_T": made.field_T[:, i].tolist() for i, axis in enumerate("xyz")}
        columns["set"] = ["validation" if is_kept else "calibration" for is_kept in schedule.is_validation]
        columns["repeat"] = _repeats(schedule)
        if schedule.has_temperature:
            columns["coil1_temperature_C"] = schedule.coil_temperature_C.tolist()
            for sensor in schedule.sensors:
                columns[f"{sensor.name}_temperature_C"] = schedule.sensor_temperature_C.tolist()
        return columns

    def rig_text(self) -> str:
        """The rig file of configs/paper_simulation.yaml at this session's distance, or another's, with its sensors."""
        title = f"hidden {self.seed}"
        first = _RIG.format(name=title, z_mm=-1e3 * self.schedule.distance_m)
        lines = [first if self.rig is None else self.rig.text(title)]
        if self.has_neighbour:
            lines.append(_neighbour_text())
        lines.append("\nsensors:\n")
        for sensor in self.schedule.sensors:
            pose = [*(1e3 * v for v in sensor.position_m), *sensor.rotation_vector_rad]
            entries = ", ".join(f"{key}: {_yaml(v)}" for key, v in zip(POSE_KEYS, pose, strict=True))
            lines.append(
                f"  {sensor.name}:\n    noise_uT: {{prior: {{log_normal: {{median: 20, relative_sd: 0.5}}}}}}\n"
                f"    world_from_sensor: {{{entries}}}\n"
            )
        return "".join(lines)


def _pose(block: str, place_m: Array, rotation: Array, count: int) -> dict[str, float]:
    """The first few free numbers of a pose, the rotation as a small one about the body's axes."""
    numbers = [*place_m.tolist(), *Rotation.from_matrix(rotation).as_rotvec().tolist()]
    return {f"{block}.{key}": v for key, v in zip(POSE[:count], numbers, strict=False)}


def _motion(schedule: Schedule, made: Record) -> dict[str, Sequence[object]]:
    """Columns of the arm."""
    if schedule.joint_rad is not None:
        return {f"arm1_q{k}_rad": schedule.joint_rad[:, k].tolist() for k in range(6)}
    columns = {f"arm1_{axis}_m": made.displacement_m[:, i].tolist() for i, axis in enumerate("xyz")}
    if schedule.turn is None:
        return columns
    turn_rad = Rotation.from_matrix(schedule.turn).as_rotvec()
    return columns | {f"arm1_r{axis}_rad": turn_rad[:, i].tolist() for i, axis in enumerate("xyz")}


def _repeats(schedule: Schedule) -> list[int]:
    """How often each setting (place, current, sensor) was read before."""
    seen: dict[tuple[float, ...], int] = {}
    counts = []
    for place, current, sensor in zip(
        schedule.displacement_m, schedule.current_A, schedule.sensor, strict=True
    ):
        key = (*place.tolist(), float(current), float(sensor))
        counts.append(seen.get(key, 0))
        seen[key] = counts[-1] + 1
    return counts


def _yaml(value: float) -> str:
    return f"{value:.15g}"


def _neighbour_text() -> str:
    """The idle neighbour with everything known."""
    pose = [*(1e3 * v for v in NEIGHBOUR_POSITION_M), *neighbour_rotation_rad()]
    entries = ", ".join(f"{key}: {_yaml(v)}" for key, v in zip(POSE_KEYS, pose, strict=True))
    return (
        f"  coil2:\n    radius_mm: {1e3 * NEIGHBOUR.radius_m:g}\n    wire_radius_mm: {1e3 * NEIGHBOUR.wire_radius_m:g}\n"
        f"    axial_loops: {NEIGHBOUR.axial_loops}\n    radial_loops: {NEIGHBOUR.radial_loops}\n"
        f"    world_from_coil: {{{entries}}}\n"
    )


_RIG = """schema_version: 1
name: {name}

movers:
  arm1:
    motion: displacement
    displacement_frame: end_effector

coils:
  coil1:
    carried_by: arm1
    radius_mm: {{value: 48, prior: {{normal: {{mean: 48, sd: 3}}}}}}
    wire_radius_mm: {{value: 0.46, prior: {{normal: {{mean: 0.46, sd: 0.03, lower: 0.2}}}}}}
    axial_loops: {{value: 45, prior: {{normal: {{mean: 45, sd: 3, lower: 1}}}}}}
    radial_loops: {{value: 22, prior: {{normal: {{mean: 22, sd: 3, lower: 1}}}}}}
    world_from_coil0:
      x_mm: {{prior: {{normal: {{mean: 0, sd: 3}}}}}}
      y_mm: {{prior: {{normal: {{mean: 0, sd: 3}}}}}}
      z_mm: {{prior: {{normal: {{mean: {z_mm:.6f}, sd: 3}}}}}}
      tilt_x_deg: {{prior: {{normal: {{mean: 0, sd: 2}}}}}}
      tilt_y_deg: {{prior: {{normal: {{mean: 0, sd: 2}}}}}}
"""
