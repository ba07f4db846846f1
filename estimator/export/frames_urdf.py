"""Calibrated frames for ROS: a URDF of the rig, and a launch file of its transforms that never change.

Links are frames without shape: `world`, for each mover on a base `NAME_base` and its joints up to `NAME_flange`, and each coil and
sensor by its name. A mover that reports displacements has a frame at rest for each body that it carries, `NAME_at_rest_BODY`, since
the rig states where each body is in the reference configuration.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

from estimator.effects.stages import MotionEffect
from estimator.effects.use import uses_of
from estimator.errors import InvalidInput
from estimator.export.calibrated import Calibrated
from estimator.export.labels import identifier, origin_of
from estimator.export.plain_model import poses_of
from estimator.export.request import Request
from estimator.export.templates import template
from estimator.frames import Transform
from estimator.geometry.motion import ends_of
from estimator.model.room_field import at_one_moment
from estimator.rig.bodies import Body, MotionKind, Mover
from estimator.tensors import torch

FIXED, REVOLUTE, FLOATING = "fixed", "revolute", "floating"


@dataclass(frozen=True)
class Joint:
    """A joint of the tree.

    Attributes:
        name, kind: Its name, and `fixed`, `revolute` about its z axis, or `floating`.
        parent, child: Links.
        origin: Pose of the joint in the parent.
    """

    name: str
    kind: str
    parent: str
    child: str
    origin: Transform


def urdf(request: Request) -> str:
    """The text of the URDF; floating joints take position and rotation of the mover.

    Raises:
        InvalidInput: As `joints_of`.
    """
    calibrated = request.calibrated
    joints = joints_of(calibrated)
    robot = ElementTree.Element("robot", name=identifier(calibrated.rig.name))
    robot.append(ElementTree.Comment(f" {origin_of(calibrated)} "))
    for link in dict.fromkeys(["world", *(joint.child for joint in joints)]):
        ElementTree.SubElement(robot, "link", name=link)
    for joint in joints:
        element = ElementTree.SubElement(robot, "joint", name=joint.name, type=joint.kind)
        ElementTree.SubElement(
            element, "origin", xyz=_words(joint.origin.translation_m), rpy=_words(rpy_rad(joint.origin))
        )
        ElementTree.SubElement(element, "parent", link=joint.parent)
        ElementTree.SubElement(element, "child", link=joint.child)
        if joint.kind == REVOLUTE:
            ElementTree.SubElement(element, "axis", xyz="0 0 1")
            ElementTree.SubElement(
                element,
                "limit",
                lower=repr(-2.0 * math.pi),
                upper=repr(2.0 * math.pi),
                effort="0",
                velocity="0",
            )
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


def static_transforms(request: Request) -> str:
    """The text of a ROS 2 launch file that publishes every fixed transform.

    Raises:
        InvalidInput: As `joints_of`.
    """
    calibrated = request.calibrated
    rows = [
        (joint.parent, joint.child, *joint.origin.translation_m.tolist(), *quaternion(joint.origin))
        for joint in joints_of(calibrated)
        if joint.kind == FIXED
    ]
    return template("static_transforms.py.j2", {}).render(
        name=identifier(calibrated.rig.name),
        origin=origin_of(calibrated),
        rows=map(repr, rows),
        given=", ".join(f'"--{key}", str({key})' for key in ("x", "y", "z", "qx", "qy", "qz", "qw")),
    )


def joints_of(calibrated: Calibrated) -> list[Joint]:
    """The tree of frames, parents first.

    Raises:
        InvalidInput: An effect of the rig changes where a mover really stands, which no tree of frames can say.
    """
    rig, values = calibrated.rig, calibrated.best_values()
    bodies: list[tuple[Body, str]] = [(coil, "coil") for coil in rig.coils] + [
        (sensor, "sensor") for sensor in rig.sensors
    ]
    carriers = {body.carried_by for body, _ in bodies}
    bent = [use.label for use in uses_of(rig, MotionEffect) if use.place in carriers]
    if bent:
        raise InvalidInput(
            f"frames must be those of the movers' readings; {', '.join(bent)} of rig {rig.name!r} changes them"
        )
    sources = at_one_moment(rig)
    joints: list[Joint] = []
    for body, kind in bodies:
        base, flange_from_body = poses_of(rig, body, sources, values, kind)
        if body.carried_by is None:
            joints.append(Joint(f"world_to_{body.name}", FIXED, "world", body.name, base))
            continue
        mover = rig.mover(body.carried_by)
        if mover.own_ends is not None:
            base_from_first, last_from_flange = ends_of(mover, torch.zeros(6, dtype=torch.float64))
            base, flange_from_body = (
                base @ base_from_first.inverse(),
                last_from_flange.inverse() @ flange_from_body,
            )
        prefix = (
            f"{mover.name}_at_rest_{body.name}"
            if mover.motion is MotionKind.DISPLACEMENT
            else f"{mover.name}_base"
        )
        flange = f"{prefix}_moved" if mover.motion is MotionKind.DISPLACEMENT else f"{mover.name}_flange"
        if all(joint.child != flange for joint in joints):
            joints += _moving(mover, base, prefix, flange)
        joints.append(Joint(f"{flange}_to_{body.name}", FIXED, flange, body.name, flange_from_body))
    return joints


def _moving(mover: Mover, base: Transform, base_link: str, flange: str) -> Iterator[Joint]:
    """Joints from the world by the base to the flange."""
    yield Joint(f"world_to_{base_link}", FIXED, "world", base_link, base)
    table = mover.table
    if table is None:
        yield Joint(f"{base_link}_to_{flange}", FLOATING, base_link, flange, Transform.identity())
        return
    so_far, last_from_flange = ends_of(mover, torch.zeros(6, dtype=torch.float64))
    parent = base_link
    z, x = torch.eye(3, dtype=torch.float64)[[2, 0]]
    columns = zip(table.theta_rad, table.a_m, table.d_m, table.alpha_rad, strict=True)
    for i, (theta_rad, a_m, d_m, alpha_rad) in enumerate(columns):
        origin = so_far @ Transform.from_pose(0.0 * z, theta_rad * z)
        link = f"{mover.name}_link{i}"
        yield Joint(f"{mover.name}_q{i}", REVOLUTE, parent, link, origin)
        parent, so_far = (
            link,
            Transform.from_pose(d_m * z, 0.0 * z) @ Transform.from_pose(a_m * x, alpha_rad * x),
        )
    yield Joint(f"{parent}_to_{flange}", FIXED, parent, flange, so_far @ last_from_flange)


def rpy_rad(pose: Transform) -> list[float]:
    """Roll, pitch and yaw about the fixed axes x, y, z, as URDF has them."""
    r = pose.rotation.tolist()
    pitch = math.atan2(-r[2][0], math.hypot(r[0][0], r[1][0]))
    # Gimbal lock: roll and yaw turn about one axis, so one of them suffices.
    if math.hypot(r[0][0], r[1][0]) < 1e-12:
        return [math.atan2(-r[1][2], r[1][1]), pitch, 0.0]
    return [math.atan2(r[2][1], r[2][2]), pitch, math.atan2(r[1][0], r[0][0])]


def quaternion(pose: Transform) -> list[float]:
    """qx, qy, qz, qw of the rotation."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(pose.rotation.numpy()).as_quat().tolist()


def _words(numbers: torch.Tensor | list[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)
