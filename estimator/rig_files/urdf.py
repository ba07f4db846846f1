"""The kinematics of an arm from a URDF file, as the Denavit-Hartenberg table that a rig holds.

The rig needs the file no more once it is read.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from estimator.errors import InvalidInput, reason
from estimator.given_files import MOST_SETTINGS_BYTES, open_given
from estimator.rig.arms import N_JOINTS, ArmEnds, DenavitHartenberg
from estimator.rig_files.joint_axes import Axis, Matrix, table_of_axes

TURNING = ("revolute", "continuous")


def arm_from_urdf(path: Path, base: str, flange: str) -> tuple[DenavitHartenberg, ArmEnds]:
    """The table of the joints between two links, and where base and flange are.

    Args:
        path: URDF file; meshes that it names are not read.
        base, flange: Links at the ends of the chain: that in which the controller reports, and that which carries.
    Returns: Joints in their order from base to flange.
    Raises:
        InvalidInput: yourdfpy is not installed, the file cannot be read, or the chain is not one of six turning joints.
    References: Denavit and Hartenberg, J. Applied Mechanics 22, 215 (1955), in the standard (distal) convention.
    """
    return table_of_axes(*_axes(path, base, flange))


def _axes(path: Path, base: str, flange: str) -> tuple[list[Axis], Matrix]:
    """Direction and a point of each joint's axis in the base frame, and base_from_flange, with all joints at zero."""
    try:
        from yourdfpy import URDF
    except ImportError as error:
        raise InvalidInput(
            f"a URDF needs the extra coilcal[urdf] (pip install 'coilcal[urdf]'); received {path}"
        ) from error
    open_given(path, MOST_SETTINGS_BYTES, rule="must be a URDF that can be read").close()
    try:
        robot = URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
    except Exception as error:  # of its parser, of any type
        raise InvalidInput(f"{path} must be a URDF that can be read: {reason(error)}") from error
    above = {joint.child: joint for joint in robot.joints}
    chain: list[Any] = []
    link = flange
    while link != base and link in above and len(chain) <= len(above):
        chain.append(above[link])
        link = above[link].parent
    names = {each.name for each in robot.links}
    if link != base or not {base, flange} <= names:
        raise InvalidInput(
            f"{path} must have joints from link {base!r} to {flange!r}; it has none that join them"
        )
    here, lines = np.eye(4), []
    for joint in reversed(chain):
        here = here if joint.origin is None else here @ joint.origin
        if joint.type in TURNING and joint.mimic is None:
            axis = np.array([1.0, 0.0, 0.0] if joint.axis is None else joint.axis, dtype=float)
            lines.append((here[:3, :3] @ (axis / np.linalg.norm(axis)), here[:3, 3].copy()))
        elif joint.type != "fixed":
            raise InvalidInput(
                f"joints from {base} to {flange} must turn freely or be fixed; {joint.name} does not ({path})"
            )
    if len(lines) != N_JOINTS:
        raise InvalidInput(
            f"{path} must have {N_JOINTS} turning joints from {base} to {flange}; it has {len(lines)}"
        )
    return lines, here
