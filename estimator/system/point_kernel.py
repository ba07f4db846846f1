"""Field and gradient of a whole magnet, point by point, in machine code: nothing is set up but the numbers of the model.

The formulas are those of `field.loop` and of the C++ header; `field.kernel` is faster for the many points that a fit asks for.
"""

from __future__ import annotations

from math import cos, floor, log2, nan, sin, sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from estimator.field.kernel import QUARTER_MU0
from estimator.field.machine_code import machine_code
from estimator.field.zones import ZONES_PER_OCTAVE


class Tables(NamedTuple):
    """The numbers of a magnet, as the kernel takes them.

    Attributes:
        windings: External radius, axial and radial loops, axial and radial pitch.
        poses: `world_from_base` and `flange_from_coil`, three rows of rotation and translation each.
        places: Of each coil its mover (-1: none), its first level, where its levels begin in `levels`, and their number.
        levels: Number of a rule by level, coil after coil.
        rules: Of each rule where its axial nodes begin, their number, the same for the radial ones, and AGM steps.
        nodes, weights: Of all rules.
        is_arm: Whether the motion of a mover is joint angles.
        joints: Denavit-Hartenberg table of each mover: theta, a, d, alpha.
        supply: Delivered current per commanded ampere.
        offset_A: Delivered current without a command.
        background_T: Field without current.
    """

    windings: Float[np.ndarray, "coil 5"]
    poses: Float[np.ndarray, "coil 2 3 4"]
    places: Int[np.ndarray, "coil 4"]
    levels: Int[np.ndarray, " level"]
    rules: Int[np.ndarray, "rule 5"]
    nodes: Float[np.ndarray, " node"]
    weights: Float[np.ndarray, " node"]
    is_arm: Int[np.ndarray, " mover"]
    joints: Float[np.ndarray, "mover 4 6"]
    supply: Float[np.ndarray, "coil coil"]
    offset_A: Float[np.ndarray, " coil"]
    background_T: Float[np.ndarray, " 3"]


@machine_code
def per_ampere(points, motion, tables, field, gradient):  # type: ignore[no-untyped-def]
    """Fill field (point, coil, 3) and gradient (point, coil, 3, 3) per delivered ampere; motion has one row, or one for each point."""
    n_coils = len(tables.windings)
    pose, moved, other = np.empty((n_coils, 3, 4)), np.empty((3, 4)), np.empty((3, 4))
    local = np.empty(3)
    for i in range(len(points)):
        if i < len(motion):
            for coil in range(n_coils):
                mover = tables.places[coil, 0]
                if mover >= 0:
                    _mover(tables.is_arm[mover], tables.joints[mover], motion[i, mover], moved, other)
                    _chain(tables.poses[coil, 0], moved, other)
                    _chain(other, tables.poses[coil, 1], pose[coil])
                else:
                    _chain(tables.poses[coil, 0], tables.poses[coil, 1], pose[coil])
        for coil in range(n_coils):
            frame = pose[coil]
            for k in range(3):
                local[k] = 0.0
                for row in range(3):
                    local[k] += frame[row, k] * (points[i, row] - frame[row, 3])
            _coil(tables, coil, local, frame, field[i, coil], gradient[i, coil])


@machine_code
def _coil(tables, coil, point, frame, field, gradient):  # type: ignore[no-untyped-def]
    """Field and gradient of one coil in the world frame; NaN inside its winding."""
    x, y, z = point
    rho2 = x * x + y * y
    radius, axial_loops, radial_loops, axial_pitch, radial_pitch = tables.windings[coil]
    rho = sqrt(rho2)
    beside = max(radius - radial_pitch * radial_loops - rho, rho - radius, 0.0)
    above = max(-axial_pitch * axial_loops - z, z, 0.0)
    distance = sqrt(beside * beside + above * above)
    if not distance > 0.0:
        field[:] = nan
        gradient[:] = nan
        return
    _, first_level, start, n_levels = tables.places[coil]
    level = min(max(floor(ZONES_PER_OCTAVE * log2(distance)) - first_level, 0), n_levels - 1)
    rule = tables.rules[tables.levels[start + level]]
    h, axial, h_z, axial_z = _sums(tables.windings[coil], rule, tables.nodes, tables.weights, rho2, z)
    # div B = 0 and curl B = 0 give the derivatives across the axis.
    across = (2.0 * h + axial_z) / rho2 if rho2 > 1e-300 else 0.0
    b = (x * h, y * h, axial)
    g = (
        (h - x * x * across, -x * y * across, x * h_z),
        (-x * y * across, h - y * y * across, y * h_z),
        (x * h_z, y * h_z, axial_z),
    )
    for row in range(3):
        field[row] = frame[row, 0] * b[0] + frame[row, 1] * b[1] + frame[row, 2] * b[2]
        for column in range(3):
            total = 0.0
            for k in range(3):
                for m in range(3):
                    total += frame[row, k] * g[k][m] * frame[column, m]
            gradient[row, column] = total


@machine_code
def _sums(winding, rule, nodes, weights, rho2, z):  # type: ignore[no-untyped-def]
    """The factors of B = (x h, y h, axial) and their derivatives along z, as `field.loop.loop_derivatives` has them."""
    h_sum, axial_sum, h_z_sum, axial_z_sum = 0.0, 0.0, 0.0, 0.0
    radius, axial_loops, radial_loops, axial_pitch, radial_pitch = winding
    for i in range(rule[0], rule[0] + rule[1]):
        above = z - axial_pitch * (nodes[i] - 0.5 * axial_loops)
        z2 = above * above
        for j in range(rule[2], rule[2] + rule[3]):
            a = radius - radial_pitch * (0.5 * radial_loops - nodes[j])
            a2 = a * a
            u, s = a2 - rho2 + z2, a2 + rho2 + z2
            p2 = u * u + 4.0 * rho2 * z2
            means = sqrt(p2)
            mean2 = 0.5 * (s + means)
            mean, t = sqrt(mean2), a2 / mean2
            square, scale = t / 16.0, 32.0
            for _ in range(rule[4]):
                geometric = sqrt(means)
                means = mean * geometric
                mean = 0.5 * (mean + geometric)
                c = square / mean
                square = rho2 * c * c
                t += scale * square
                scale *= 2.0
            inverse = 1.0 / p2
            common = weights[i] * weights[j] * QUARTER_MU0 / mean * inverse
            v, qt, bracket, both = 2.0 * z2 - u, rho2 * t, 4.0 * a2 - s * t, 2.0 * a2 * u
            axial = (both + qt * v) * common
            whole, shared = (both + v * s) * inverse, (both * s + 4.0 * v * a2 * rho2) * inverse
            along_q = 0.25 * ((2.0 * qt + bracket) * whole + v * t) - 0.5 * shared - 2.0 * a2 + qt
            along_z2 = 0.5 * qt * whole - 0.5 * shared + 2.0 * a2 + qt
            h_sum += bracket * common * above
            axial_sum += axial
            h_z_sum += 2.0 * (common * along_q - 2.0 * axial * v * inverse)
            axial_z_sum += 2.0 * above * (common * along_z2 - axial * (2.0 * u + 4.0 * rho2) * inverse)
    return h_sum, axial_sum, h_z_sum, axial_z_sum


@machine_code
def _mover(is_arm, joints, motion, pose, spare):  # type: ignore[no-untyped-def]
    """Fill the pose of a mover from position and rotation vector, or from joint angles."""
    if not is_arm:
        _turn(motion[3], motion[4], motion[5], pose)
        for row in range(3):
            pose[row, 3] = motion[row]
        return
    link, turned = np.empty((3, 4)), np.empty((3, 4))
    pose[:] = 0.0
    for row in range(3):
        pose[row, row] = 1.0
    for i in range(6):
        _turn(0.0, 0.0, motion[i] + joints[0, i], turned)
        turned[2, 3] = joints[2, i]
        _turn(joints[3, i], 0.0, 0.0, link)
        link[0, 3] = joints[1, i]
        _chain(pose, turned, spare)
        _chain(spare, link, pose)


@machine_code
def _turn(x, y, z, pose):  # type: ignore[no-untyped-def]
    """Fill a pose without translation from a rotation vector."""
    angle = sqrt(x * x + y * y + z * z)
    sinc, half = (sin(angle) / angle, sin(0.5 * angle) / angle) if angle > 0.0 else (1.0, 0.5)
    versine = 2.0 * half * half
    c = cos(angle)
    pose[0, 0], pose[0, 1], pose[0, 2] = (
        c + versine * x * x,
        versine * x * y - sinc * z,
        versine * x * z + sinc * y,
    )
    pose[1, 0], pose[1, 1], pose[1, 2] = (
        versine * x * y + sinc * z,
        c + versine * y * y,
        versine * y * z - sinc * x,
    )
    pose[2, 0], pose[2, 1], pose[2, 2] = (
        versine * x * z - sinc * y,
        versine * y * z + sinc * x,
        c + versine * z * z,
    )
    for row in range(3):
        pose[row, 3] = 0.0


@machine_code
def _chain(a, b, product):  # type: ignore[no-untyped-def]
    """Fill the product of two poses."""
    for row in range(3):
        for column in range(4):
            product[row, column] = a[row, 3] if column == 3 else 0.0
            for k in range(3):
                product[row, column] += a[row, k] * b[k, column]
