"""Bodies of a laboratory: movers, coils of every kind and sensors, as frozen records; all numbers are parameters of the rig."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from typing import ClassVar

from estimator.rig.arms import ARMS, ArmEnds, DenavitHartenberg
from estimator.rig.charged_box import (
    MULTIPOLE_DEGREE,
    Triple,
    charge_key,
    gap_m,
    intervals,
    multipole_key,
    n_charges,
)
from estimator.rig.harmonic_terms import amplitude_key, terms

# Position and rotation vector.
CARTESIAN = (
    ("x", "length"),
    ("y", "length"),
    ("z", "length"),
    ("rx", "angle"),
    ("ry", "angle"),
    ("rz", "angle"),
)
POSE_QUANTITIES = (*CARTESIAN, *((turn, "angle") for turn in ("tilt_x", "tilt_y", "spin")))  # of a mount
POSE_KEYS = tuple(f"{quantity}_{'m' if kind == 'length' else 'rad'}" for quantity, kind in POSE_QUANTITIES)


class MotionKind(StrEnum):
    """What a mover's columns in a session mean."""

    POSE = "pose"  # base_from_flange as position and rotation vector
    DISPLACEMENT = "displacement"  # position relative to a reference configuration
    JOINTS = "joints"  # six joint angles of an arm whose table the rig file holds
    UR3 = "UR3"  # six joint angles of one of Universal Robots
    UR5 = "UR5"
    UR10 = "UR10"
    UR3E = "UR3e"
    UR5E = "UR5e"
    UR10E = "UR10e"
    UR16E = "UR16e"
    UR20 = "UR20"


class DisplacementFrame(StrEnum):
    """Axes in which a displacement is reported."""

    END_EFFECTOR = "end_effector"
    BASE = "base"


class FieldSum(StrEnum):
    """How the fields of a winding's loops are added."""

    VECTORS = "vectors"
    SPHERICAL_COMPONENTS = "spherical_components"  # about different centres, as the paper's eq 13 has it: wrong, kept for comparison


@dataclass(frozen=True)
class Mover:
    """A robot or stage.

    Attributes:
        motion: What its columns in a session mean.
        displacement_frame: Axes of reported displacements.
        reference_rotation_rad: base_from_flange at the reference configuration, as a rotation vector. It turns displacements that are
            reported in the base frame into the end-effector frame.
        own_table: Kinematics of this individual arm: all of it for `joints`, else the maker's factory calibration as differences from the
            nominal table.
        own_ends: Transforms before and after that table.
    """

    name: str
    motion: MotionKind
    displacement_frame: DisplacementFrame = DisplacementFrame.END_EFFECTOR
    reference_rotation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # `Rig.hash` names the table and the ends, where there are any.
    own_table: DenavitHartenberg | None = field(default=None, repr=False)
    own_ends: ArmEnds | None = field(default=None, repr=False)

    @property
    def table(self) -> DenavitHartenberg | None:
        """Kinematics of an arm that reports joint angles; None where poses or displacements are reported."""
        nominal = ARMS.get(str(self.motion))
        if nominal is None or self.own_table is None:
            return nominal or self.own_table
        return nominal.corrected(self.own_table)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of this mover's columns in a readings table."""
        if self.table is not None:
            return tuple(f"{self.name}_q{i}_rad" for i in range(6))
        return tuple(f"{self.name}_{axis}" for axis in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad"))


@dataclass(frozen=True)
class Body:
    """A coil or a sensor: fixed in the world, or carried by a mover.

    Attributes:
        is_wound: Whether it is a coil whose winding is described.
    """

    is_wound: ClassVar[bool] = False
    name: str
    carried_by: str | None = None


Point = tuple[float, float, float]
Path = tuple[Point, ...]  # of a wire, from point to point, in m


@dataclass(frozen=True)
class Leads:
    """Straight pieces of wire that bring the current to a winding and take it away, in the coil's frame.

    Attributes:
        towards, away: Points that the current passes, in its order.
    """

    towards: Path = ()
    away: Path = ()

    @property
    def pieces(self) -> tuple[tuple[Point, Point], ...]:
        """Ends of each piece of wire, in the order of the current."""
        return (*pairwise(self.towards), *pairwise(self.away))


@dataclass(frozen=True)
class Coil(Body):
    """A circular multi-layer winding.

    Attributes:
        field_sum: How the fields of its loops are added.
        is_superconducting: Its wire may hold on to flux.
        leads: Of its current, where they are described.
    """

    is_wound = True
    field_sum: FieldSum = FieldSum.VECTORS
    is_superconducting: bool = False
    leads: Leads | None = field(default=None, repr=False)  # `Rig.hash` names them where they are


@dataclass(frozen=True)
class SidedCoil(Body):
    """A multi-layer winding with straight sides: rectangular loops, or racetracks, whose corners are arcs.

    Attributes:
        field_sum: How the fields of its loops are added.
        is_rounded: Corners are arcs, the wider the farther out the layer; else they are sharp in every layer.
        leads: Of its current, where they are described.
    """

    is_wound = True
    field_sum: ClassVar[FieldSum] = FieldSum.VECTORS
    is_rounded: bool = False
    leads: Leads | None = field(default=None, repr=False)  # as of `Coil`


class Region(StrEnum):
    """Region about the origin of a coil's frame in which the field of a coil without a winding is described."""

    INTERIOR = "interior"  # in and around a ball that holds the readings; the sources are outside
    EXTERIOR = "exterior"  # outside a ball that holds all sources: multipoles


@dataclass(frozen=True)
class HarmonicCoil(Body):
    """A coil whose winding is not known: per ampere its field is a sum of solid harmonics about the origin of its frame.

    Amplitudes are parameters `name.degree1_cos0_T_per_A`, each the rms of its term on the sphere of radius `name.reference_radius_m`.

    Attributes:
        region: Inside a ball without sources, or outside the ball that holds them.
        degree: Highest degree, from 1 (uniform inside, a dipole outside).
        has_degrees: Its amplitudes have degrees.
    """

    has_degrees: ClassVar[bool] = True
    region: Region = Region.INTERIOR
    degree: int = 1

    @property
    def amplitudes(self) -> dict[int, tuple[str, ...]]:
        """Names of its amplitudes by degree, in the order of `terms`."""
        return {
            degree: tuple(f"{self.name}.{amplitude_key(degree, term)}" for term in terms(degree))
            for degree in range(1, self.degree + 1)
        }


@dataclass(frozen=True)
class EquivalentSourceCoil(Body):
    """A coil whose winding is not known: per ampere its field is that of magnetic charges on a box about the origin of its frame.

    Amplitudes are parameters `name.charge1_T_per_A` and so on. They are normalised: independent amplitudes of rms 1 make a field of rms 1
    in the middle of the box. Amplitudes of a multipole, such as `name.multipole1_degree1_cos0_T_per_A`, are normalised degree by degree
    where the box comes nearest to it.

    Attributes:
        half_m: Half of each edge of a box without sources that holds the readings.
        margin_m: Distance from that box to the surface of a larger one, on which the charges stand.
        spacing_m: Distance of neighbouring charges, roughly.
        multipoles_m: Positions of small sources outside the first box, too close to it for the charges to represent.
        has_degrees: Its amplitudes have none.
    """

    has_degrees: ClassVar[bool] = False
    half_m: Triple = (1.0, 1.0, 1.0)
    margin_m: float = 1.0
    spacing_m: float = 1.0
    multipoles_m: tuple[Triple, ...] = field(default=(), repr=False)  # `Rig.hash` names them where they are

    @property
    def charged_half_m(self) -> Triple:
        """Half of each edge of the box with the charges."""
        x_m, y_m, z_m = self.half_m
        return x_m + self.margin_m, y_m + self.margin_m, z_m + self.margin_m

    @property
    def intervals(self) -> tuple[int, int, int]:
        """Intervals between charges along each edge."""
        return intervals(self.half_m, self.margin_m, self.spacing_m)

    @property
    def n_charges(self) -> int:
        """Number of charges on the box."""
        return n_charges(self.intervals)

    @property
    def multipole_gaps_m(self) -> tuple[float, ...]:
        """Distance of each multipole from the first box."""
        return tuple(gap_m(place_m, self.half_m) for place_m in self.multipoles_m)

    @property
    def amplitudes(self) -> dict[int, tuple[str, ...]]:
        """Names of its amplitudes, charges before multipoles. Charges have no degrees, so all stand under the first."""
        keys = [charge_key(number) for number in range(1, self.n_charges + 1)]
        keys += [
            multipole_key(number, degree, term)
            for number in range(1, len(self.multipoles_m) + 1)
            for degree in range(1, MULTIPOLE_DEGREE + 1)
            for term in terms(degree)
        ]
        return {1: tuple(f"{self.name}.{key}" for key in keys)}


WoundCoil = Coil | SidedCoil
UnwoundCoil = HarmonicCoil | EquivalentSourceCoil
AnyCoil = WoundCoil | UnwoundCoil


class Sensor(Body):
    """A three-axis magnetometer; single components may be missing in its readings."""
