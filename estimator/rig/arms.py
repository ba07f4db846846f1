"""Kinematics of arms that report joint angles: Denavit-Hartenberg tables of Universal Robots, of any other arm, and their corrections."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from math import pi

N_JOINTS = 6  # of every arm


@dataclass(frozen=True)
class DenavitHartenberg:
    """Standard (distal) Denavit-Hartenberg table, one entry per joint, in the columns of Universal Robots.

    A joint at angle q leads to the next one: turn by q + theta about z, shift by d along z, shift by a along x, turn
    by alpha about x.
    """

    theta_rad: tuple[float, ...]
    a_m: tuple[float, ...]
    d_m: tuple[float, ...]
    alpha_rad: tuple[float, ...]

    def corrected(self, by: DenavitHartenberg) -> DenavitHartenberg:
        """The table of one arm, given what its maker measured as differences from this one.

        Examples:
            >>> none = (0.0,) * 6
            >>> ARMS["UR5e"].corrected(DenavitHartenberg(none, none, (1e-4,) * 6, none)).d_m[0]
            0.1626
        """
        columns = (
            tuple(own + more for own, more in zip(*both, strict=True))
            for both in zip(astuple(self), astuple(by), strict=True)
        )
        return DenavitHartenberg(*columns)


@dataclass(frozen=True)
class ArmEnds:
    """Transforms before and after the table of an arm, as positions and rotation vectors (m, rad).

    `base_from_first` leads to a frame whose z axis is that of the first joint, `last_from_flange` from the frame after the last row.
    """

    base_from_first: tuple[float, ...] = (0.0,) * 6
    last_from_flange: tuple[float, ...] = (0.0,) * 6


def _universal_robot(a_m: tuple[float, float], d_m: tuple[float, float, float, float]) -> DenavitHartenberg:
    """The table of an arm of Universal Robots: lengths of upper arm and forearm, then of base and wrists 1, 2 and 3."""
    none = 0.0
    return DenavitHartenberg(
        theta_rad=(none,) * 6,
        a_m=(none, *a_m, none, none, none),
        d_m=(d_m[0], none, none, *d_m[1:]),
        alpha_rad=(pi / 2, none, none, pi / 2, -pi / 2, none),
    )


# Universal Robots, support page "DH Parameters for calculations of kinematics and dynamics". (The appendix of
# a CB3 manual prints d1 = 0.118 m for the UR3; that is the shoulder height of the UR10 in the same appendix.)
ARMS: dict[str, DenavitHartenberg] = {
    "UR3": _universal_robot((-0.24365, -0.21325), (0.1519, 0.11235, 0.08535, 0.0819)),
    "UR5": _universal_robot((-0.425, -0.39225), (0.089159, 0.10915, 0.09465, 0.0823)),
    "UR10": _universal_robot((-0.612, -0.5723), (0.1273, 0.163941, 0.1157, 0.0922)),
    "UR3e": _universal_robot((-0.24355, -0.2132), (0.15185, 0.13105, 0.08535, 0.0921)),
    "UR5e": _universal_robot((-0.425, -0.3922), (0.1625, 0.1333, 0.0997, 0.0996)),
    "UR10e": _universal_robot((-0.6127, -0.57155), (0.1807, 0.17415, 0.11985, 0.11655)),
    "UR16e": _universal_robot((-0.4784, -0.36), (0.1807, 0.17415, 0.11985, 0.11655)),
    "UR20": _universal_robot((-0.8620, -0.7287), (0.2363, 0.2010, 0.1593, 0.1543)),
}
