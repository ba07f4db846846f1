"""The laboratory: coils, sensors, and the movers that carry them, as frozen records.

The records say what there is and what carries what; all numbers are `Parameter`s under dotted names such as
`coil1.world_from_coil.x_m`. `estimator.rig_files` reads them from YAML; `estimator.model` predicts readings from them.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from estimator.errors import InvalidInput, closest
from estimator.glance import Shown
from estimator.rig.bodies import AnyCoil, Coil, Mover, Sensor, UnwoundCoil, WoundCoil
from estimator.rig.first import first_rig
from estimator.rig.parameters import JointNormal, Parameter
from estimator.rig.rules import broken_rules

# Attributes that `repr` of a body leaves out. `Rig.hash` has them only where they are set, so that others keep the hash of old versions.
NOT_IN_REPR = ("own_table", "own_ends", "leads", "multipoles_m")

EVERYWHERE = "everywhere"  # place of a cause at all sensors, coils or movers


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
        joint: Prior of some free parameters together, such as an earlier posterior.
    """

    name: str
    coils: tuple[AnyCoil, ...]
    sensors: tuple[Sensor, ...]
    movers: tuple[Mover, ...]
    parameters: Mapping[str, Parameter]
    effects: tuple[Cause, ...] = ()
    devices: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    corrections: tuple[Cause, ...] = ()
    joint: JointNormal | None = None

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
        are the Earth's field and the zero of the sensor. `coilcal init` writes the same as a file, with more choices.

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
        first = first_rig(radius_m, axial_loops, radial_loops, wire_radius_m, distance_m, noise_T, moves)
        effects = tuple(Cause(*effect) for effect in first.effects)
        rig = cls(name, (first.coil,), (first.sensor,), (first.mover,), first.parameters, effects)
        for broken, rule, received in rig.broken_rules():
            raise InvalidInput(f"{broken.partition('.')[2]} {rule}; received {received}")
        return rig

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that a fit may move."""
        return tuple(p for p in self.parameters.values() if p.is_free)

    def check_free(self) -> None:
        """Refuse a rig that no fit can change.

        Raises:
            InvalidInput: No parameter is free.
        """
        if not self.free:
            raise InvalidInput(
                f"rig must have at least one free parameter (a prior); rig {self.name!r} has none"
            )

    @property
    def wound(self) -> tuple[WoundCoil, ...]:
        """The coils whose winding is described."""
        return tuple(coil for coil in self.coils if isinstance(coil, WoundCoil))

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
    def keys_by_label(self) -> Mapping[str, tuple[str, ...]]:
        """Keys of the quantities of each effect and correction that has any, by its label."""
        keys: dict[str, list[str]] = {}
        for name in self.parameters:
            place, is_of_cause, key = name.partition("].")
            if is_of_cause:
                keys.setdefault(f"{place}]", []).append(key)
        return {label: tuple(own) for label, own in keys.items()}

    def names_of(self, cause: Cause) -> dict[str, str]:
        """Names of the parameters of an effect or correction, by their keys."""
        return {key: f"{cause.label}.{key}" for key in self.keys_by_label.get(cause.label, ())}

    @property
    def hash(self) -> str:
        """SHA-256 over the structure and every parameter, not over the devices."""
        lines = [repr((self.name, self.coils, self.sensors, self.movers, *self.acting))]
        lines += [repr(parameter) for parameter in self.parameters.values()]
        lines += [
            f"{body.name} {value!r}"
            for what in NOT_IN_REPR
            for body in (*self.movers, *self.coils)
            if (value := getattr(body, what, None))
        ]
        lines += [repr(self.joint)] if self.joint else []
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
        own = {*self.names_of(cause).values()}
        parameters = {name: p for name, p in self.parameters.items() if name not in own}
        effects, corrections = (
            tuple(other for other in acting if other != cause) for acting in (self.effects, self.corrections)
        )
        return replace(self, parameters=parameters, effects=effects, corrections=corrections)

    def broken_rule(self) -> tuple[str, str, str] | None:
        """First impossible nominal value: parameter, broken rule and value; None where all are possible."""
        return next(self.broken_rules(), None)

    def broken_rules(self) -> Iterator[tuple[str, str, str]]:
        """Every impossible nominal value: parameter, broken rule and value."""
        return broken_rules(self.parameters, self.wound, self.nominal_values())

    def nominal_values(self) -> dict[str, float]:
        """Nominal value of every parameter, ties resolved."""
        return dict(self._nominal_values)

    @cached_property
    def _nominal_values(self) -> dict[str, float]:
        return {name: self._nominal(name) for name in self.parameters}

    def _nominal(self, name: str) -> float:
        parameter = self.parameters[name]
        return parameter.tie.factor * self._nominal(parameter.tie.to) if parameter.tie else parameter.value
