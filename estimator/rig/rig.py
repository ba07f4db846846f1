"""What stands in the laboratory: coils, sensors, and the movers that carry them, as frozen records.

The records name things and say how they hang together; all numbers are `Parameter`s under dotted names such as
`coil1.world_from_coil.x_m`. `estimator.rig_files` reads them from YAML; `estimator.model` predicts readings from them.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar

from estimator.errors import InvalidInput, closest
from estimator.glance import Glance, Shown
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
from estimator.rig.parameters import Parameter

MOST_LOOPS = 5000  # along or across one winding; the exact sum, beside which a quadrature rule is chosen, grows with their square
MOST_TURNS = 200_000  # of one winding

ROUNDING = 1e-12  # of lengths that are the same but for their units

POSE_KEYS = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad", "tilt_x_rad", "tilt_y_rad", "spin_rad")
POSE_QUANTITIES = (
    ("x", "length"),
    ("y", "length"),
    ("z", "length"),
    ("rx", "angle"),
    ("ry", "angle"),
    ("rz", "angle"),
    ("tilt_x", "angle"),
    ("tilt_y", "angle"),
    ("spin", "angle"),
)

EVERYWHERE = "everywhere"  # place of a cause at all sensors, coils or movers


class MotionKind(StrEnum):
    """What a mover's column in the session says."""

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
    """A robot or stage; `motion` says what its readings mean.

    `reference_rotation_rad` is base_from_flange at the reference configuration as a rotation vector; it turns displacements that the
    controller reports in the base frame into the end-effector frame. `own_table` is the kinematics of this very arm: of `joints` all of it,
    of the others what the maker measured at the factory, as differences from the nominal table. `own_ends` lie before and after that table.
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
        is_wound: A coil whose winding is described.
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
        field_sum: How its simulation adds loops.
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
        field_sum: How its simulation adds loops.
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
    """

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

    Amplitudes are parameters `name.charge1_T_per_A` and so on: were all independent, with rms 1, the field in the middle would have rms 1.
    Those of a multipole, such as `name.multipole1_degree1_cos0_T_per_A`, would make rms 1 in each degree where its box comes nearest.

    Attributes:
        half_m: Half of each edge of a box without sources that holds the readings.
        margin_m: How far outside that box the charges stand, on the surface of another.
        spacing_m: Distance of neighbouring charges, roughly.
        multipoles_m: Places outside the first box of small sources so close to it that the charges cannot stand for them.
    """

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
        """Between charges, along each edge."""
        return intervals(self.half_m, self.margin_m, self.spacing_m)

    @property
    def n_charges(self) -> int:
        """How many charges stand on the box."""
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


@dataclass(frozen=True)
class Cause:
    """An effect that a rig is known or supposed to have; its numbers are parameters named `cause[place].quantity`."""

    name: str
    place: str

    @property
    def label(self) -> str:
        """Cause and place, as in rig files."""
        return f"{self.name}[{self.place}]"


@dataclass(frozen=True, repr=False)
class Rig(Shown):
    """A laboratory as the model sees it.

    Attributes:
        name: Shown in titles.
        coils, sensors, movers: In the order of the session's columns.
        parameters: Every number by its dotted name, in file order.
        effects: What is known or supposed to be wrong with it.
        devices: Settings of the instruments by the name of what they serve; no part of what identifies the rig.
        corrections: What its predictions are corrected by without a known cause.
    """

    name: str
    coils: tuple[AnyCoil, ...]
    sensors: tuple[Sensor, ...]
    movers: tuple[Mover, ...]
    parameters: Mapping[str, Parameter]
    effects: tuple[Cause, ...] = ()
    devices: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    corrections: tuple[Cause, ...] = ()

    @classmethod
    def coil(
        cls,
        radius_m: float,
        axial_loops: float,
        radial_loops: float = 1.0,
        *,
        wire_radius_m: float,
        distance_m: float = 0.04,
        noise_T: float = 20e-6,
        moves: str = "sensor",
        name: str = "my rig",
    ) -> Rig:
        """A first rig without a file: one round coil, one three-axis sensor, and a stage that carries one of them.

        Its bodies are `coil1`, `hall` and `stage`; the columns of a table are `coil1_current_A`, `stage_x_m`, `stage_y_m`, `stage_z_m` (how
        far the stage went) and `Bx_T`, `By_T`, `Bz_T`, in other units too. All that a ruler and a maker's note leave open is free, and so
        are the Earth's field and the zero of the sensor. `coilcal init` writes the same as a file, with more of a choice.

        Args:
            radius_m: Outer radius of the winding.
            axial_loops, radial_loops: Turns along the axis, and layers.
            wire_radius_m: Half the distance of neighbouring turns.
            distance_m: From the front face of the winding to the sensor, along the axis, where the stage is at zero.
            noise_T: Scatter of one component of one reading.
            moves: What the stage carries, `sensor` or `coil`.
            name: Shown in titles.
        Raises:
            InvalidInput: A number is impossible.
        Examples:
            >>> Rig.coil(0.05, 30, 12, wire_radius_m=0.0004).coils[0].name
            'coil1'
        """
        from estimator.rig.first import rig_of_coil

        return rig_of_coil(
            radius_m, axial_loops, radial_loops, wire_radius_m, distance_m, noise_T, moves, name
        )

    def glance(self) -> Glance:
        """What is shown of it: its bodies and free numbers."""
        from estimator.rig.shown import rig_glance

        return rig_glance(self)

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that a fit may move."""
        return tuple(p for p in self.parameters.values() if p.is_free)

    @property
    def wound(self) -> tuple[WoundCoil, ...]:
        """The coils whose winding is described."""
        return tuple(coil for coil in self.coils if isinstance(coil, Coil | SidedCoil))

    @property
    def round(self) -> tuple[Coil, ...]:
        """The coils whose winding is described and whose loops are circles."""
        return tuple(coil for coil in self.wound if isinstance(coil, Coil))

    @property
    def unwound(self) -> tuple[UnwoundCoil, ...]:
        """The coils whose winding is not known."""
        return tuple(coil for coil in self.coils if isinstance(coil, UnwoundCoil))

    @property
    def acting(self) -> tuple[Cause, ...]:
        """Effects and corrections: all that changes what the bodies alone would do."""
        return (*self.effects, *self.corrections)

    @cached_property
    def found(self) -> dict[Hashable, Any]:
        """What others have found out about this rig and ask again and again, by their own keys. It is not stored."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "found"}

    @cached_property
    def keys_by_label(self) -> Mapping[str, tuple[str, ...]]:
        """Keys of the quantities of each effect and correction that has any, by its label."""
        keys: dict[str, list[str]] = {}
        for name in self.parameters:
            place, is_of_cause, key = name.partition("].")
            if is_of_cause:
                keys.setdefault(f"{place}]", []).append(key)
        return {label: tuple(own) for label, own in keys.items()}

    @property
    def hash(self) -> str:
        """SHA-256 over the structure and every parameter, not over the devices."""
        lines = [repr((self.name, self.coils, self.sensors, self.movers, *self.acting))]
        lines += [repr(parameter) for parameter in self.parameters.values()]
        lines += [f"{mover.name} {mover.own_table!r}" for mover in self.movers if mover.own_table is not None]
        lines += [f"{mover.name} {mover.own_ends!r}" for mover in self.movers if mover.own_ends is not None]
        lines += [f"{coil.name} {coil.leads!r}" for coil in self.wound if coil.leads is not None]
        lines += [
            f"{coil.name} {coil.multipoles_m!r}"
            for coil in self.unwound
            if isinstance(coil, EquivalentSourceCoil) and coil.multipoles_m
        ]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()

    def mover(self, name: str) -> Mover:
        """The mover of that name."""
        return next(mover for mover in self.movers if mover.name == name)

    def with_values(self, values: Mapping[str, float]) -> Rig:
        """This rig with other nominal values.

        Raises:
            InvalidInput: A name is not a parameter of the rig, or is tied to another.
        """
        parameters = dict(self.parameters)
        for name, value in values.items():
            if name not in parameters:
                raise InvalidInput(f"rig {self.name!r} has no parameter {name!r}{closest(name, parameters)}")
            tie = parameters[name].tie
            if tie is not None:
                raise InvalidInput(f"{name} is tied to {tie.to} in rig {self.name!r}; set that one")
            parameters[name] = replace(parameters[name], value=value)
        return replace(self, parameters=parameters)

    def depends_on_data(self, name: str) -> bool:
        """Whether a parameter is free, or tied to one that is."""
        parameter = self.parameters[name]
        return self.depends_on_data(parameter.tie.to) if parameter.tie else parameter.is_free

    def with_fixed(self, names: Iterable[str]) -> Rig:
        """This rig with some parameters fixed at their nominal values."""
        return self.with_parameters(replace(self.parameters[name], prior=None) for name in names)

    def with_parameters(self, parameters: Iterable[Parameter]) -> Rig:
        """This rig with other descriptions of some of its parameters."""
        replaced = {parameter.name: parameter for parameter in parameters}
        return replace(self, parameters={**self.parameters, **replaced})

    def with_cause(self, cause: Cause, parameters: Iterable[Parameter]) -> Rig:
        """This rig with one more effect, whose parameters are named `cause[place].quantity`."""
        quantities = {parameter.name: parameter for parameter in parameters}
        labels = tuple(f"{correction.label}." for correction in self.corrections)
        last = {n: p for n, p in self.parameters.items() if n.startswith(labels)}  # as rig files have them
        before = {n: p for n, p in self.parameters.items() if n not in last}
        return replace(self, parameters={**before, **quantities, **last}, effects=(*self.effects, cause))

    def with_correction(self, cause: Cause, parameters: Iterable[Parameter]) -> Rig:
        """This rig with one more correction, whose parameters are named `correction[place].quantity`."""
        quantities = {parameter.name: parameter for parameter in parameters}
        corrections = (*self.corrections, cause)
        return replace(self, parameters={**self.parameters, **quantities}, corrections=corrections)

    def without_cause(self, cause: Cause) -> Rig:
        """This rig without an effect or a correction."""
        parameters = {n: p for n, p in self.parameters.items() if not n.startswith(f"{cause.label}.")}
        effects, corrections = (
            tuple(c for c in all_ if c != cause) for all_ in (self.effects, self.corrections)
        )
        return replace(self, parameters=parameters, effects=effects, corrections=corrections)

    def broken_rule(self) -> tuple[str, str, str] | None:
        """First impossible nominal value: parameter, broken rule and value; None where all are possible."""
        return next(self.broken_rules(), None)

    def broken_rules(self) -> Iterator[tuple[str, str, str]]:
        """Every impossible nominal value: parameter, broken rule and value."""
        values = self.nominal_values()
        for name, value in values.items():
            parameter = self.parameters[name]
            if not math.isfinite(value):
                yield name, "must be finite", f"{value}"
            elif parameter.is_count and value < 1.0:
                yield name, "must be at least 1", f"{value:g}"
            elif parameter.is_count and value > MOST_LOOPS:
                yield name, f"must be at most {MOST_LOOPS}", f"{value:g}"
            # A noise of 0 is fine in a simulation, a length of 0 is not.
            elif parameter.is_positive and (value < 0.0 or (value == 0.0 and parameter.unit == "m")):
                yield name, "must be > 0", f"{value:g} {parameter.unit}"
        for coil in self.wound:
            if isinstance(coil, SidedCoil):
                yield from _broken_corners(coil, values)
            else:
                yield from _broken_bore(coil, values)
            turns = values[f"{coil.name}.axial_loops"] * values[f"{coil.name}.radial_loops"]
            if turns > MOST_TURNS:
                rule = f"x radial_loops must be at most {MOST_TURNS}"
                yield f"{coil.name}.axial_loops", rule, f"{turns:g}"

    def nominal_values(self) -> dict[str, float]:
        """Nominal value of every parameter, ties resolved."""
        return dict(self._nominal_values)

    @cached_property
    def _nominal_values(self) -> dict[str, float]:
        return {name: self._nominal(name) for name in self.parameters}

    def _nominal(self, name: str) -> float:
        parameter = self.parameters[name]
        return parameter.tie.factor * self._nominal(parameter.tie.to) if parameter.tie else parameter.value


def _broken_bore(coil: Coil, values: Mapping[str, float]) -> Iterator[tuple[str, str, str]]:
    radius_m = values[f"{coil.name}.radius_m"]
    thickness_m = values[f"{coil.name}.radial_pitch_m"] * values[f"{coil.name}.radial_loops"]
    if radius_m <= thickness_m:
        rule = f"must exceed radial_pitch x radial_loops = {thickness_m * 1e3:.6g} mm (no bore is left)"
        yield f"{coil.name}.radius_m", rule, f"{radius_m * 1e3:.6g} mm"


def _broken_corners(coil: SidedCoil, values: Mapping[str, float]) -> Iterator[tuple[str, str, str]]:
    if not coil.is_rounded:
        return
    radius_m = values[f"{coil.name}.inner_corner_radius_m"]
    shorter_m = min(values[f"{coil.name}.inner_side_{axis}_m"] for axis in "xy")
    if radius_m > 0.5 * shorter_m * (1.0 + ROUNDING):
        rule = f"must be at most half the shorter side, {500.0 * shorter_m:.6g} mm"
        yield f"{coil.name}.inner_corner_radius_m", rule, f"{radius_m * 1e3:.6g} mm"
