"""The transform between the vector that a fit or a sampler moves and the parameters of a rig.

In these coordinates a coil's posterior is close to normal (docs/decisions/0007). Positive numbers are logarithms. The
rms radius of the loops replaces the external radius, sides and corner radius of the mean loop those of the bore, and the position of the
winding's middle that of its front face. Turns, length and thickness, which the data determine separately, replace wire radius and loop
counts. With `integer_counts` the free loop counts are whole numbers, unchanged in the last columns.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from estimator.derivatives import jacobian_of
from estimator.rig.joint_prior import JointPrior
from estimator.rig.natural import Logarithm, Resolve, natural_of
from estimator.rig.parameters import Parameter, Prior
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

Values = Mapping[str, Tensor]


def nominal_tensors(rig: Rig, like: Tensor | None = None) -> dict[str, Tensor]:
    """Nominal value of every number of a rig, of the kind of another tensor; in double precision on the processor by default."""
    like = torch.empty(0, dtype=torch.float64) if like is None else like
    return {name: like.new_tensor(value) for name, value in rig.nominal_values().items()}


class Coordinates:
    """The free parameters of a rig as one vector, and back.

    Examples:
        >>> from estimator.rig_files.read import rig_from_text
        >>> rig = rig_from_text('''
        ... schema_version: 1
        ... name: one loop
        ... coils:
        ...   coil1: {radius_mm: 50, wire_radius_mm: 1, axial_loops: 1, radial_loops: 1, world_from_coil: {z_mm:
        ...     {prior: {normal: {mean: 0, sd: 2}}}}}
        ... sensors: {hall: {noise_uT: 20}}
        ... ''')
        >>> coordinates = Coordinates(rig)
        >>> coordinates.names
        ('coil1.world_from_coil.z_m',)
        >>> coordinates.values(torch.tensor([0.001]))["coil1.world_from_coil.z_m"]
        tensor(0.0010)
    """

    def __init__(self, rig: Rig, integer_counts: bool = False) -> None:
        self.rig = rig
        self.integer_counts = integer_counts
        free = rig.free
        counts = [p for p in free if p.is_count] if integer_counts else []
        self.parameters: tuple[Parameter, ...] = (*(p for p in free if p not in counts), *counts)
        self.n_counts = len(counts)
        self._column = {parameter.name: i for i, parameter in enumerate(self.parameters)}
        self._natural = natural_of(rig, self.parameters, counts)
        self._mix = self._natural_mix()
        self._unmix = np.linalg.inv(self._mix)
        self._fixed_values: dict[tuple[torch.dtype, torch.device], dict[str, Tensor]] = {}
        self.device = torch.device("cpu")

    def on(self, device: torch.device) -> Coordinates:
        """These coordinates with starts, scales, bounds and draws on another device, always in double precision."""
        if device == self.device:
            return self
        other = copy(self)
        for made_there in ("scale", "coupled"):
            other.__dict__.pop(made_there, None)
        other.device = device
        return other

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, in the order of the columns."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def n(self) -> int:
        """Length of the vector, counts included."""
        return len(self.parameters)

    @property
    def n_continuous(self) -> int:
        """Number of columns before the whole-numbered counts."""
        return self.n - self.n_counts

    @property
    def labels(self) -> tuple[str, ...]:
        """Meaning of each column, in words."""
        words = {"thickness_m": "winding thickness", "turns": "turns", "length_m": "winding length"}
        return tuple(
            own.label if key is None else f"{own.coil} {words[key]}"
            for own, key in zip(self._natural, self._mixed, strict=True)
        )

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantity of each column, by its name in `summary.json`: a parameter, or a number that follows from several."""
        return tuple(
            own.quantity if key is None else f"{own.coil}.{key}"
            for own, key in zip(self._natural, self._mixed, strict=True)
        )

    @property
    def _mixed(self) -> list[str | None]:
        """Quantity of a winding that stands in the column of a parameter; None where the parameter itself does."""
        keys = {"wire_radius_m": "thickness_m", "axial_loops": "turns", "radial_loops": "length_m"}
        return [
            keys[own.name.partition(".")[2]] if row.sum() > 1.5 else None
            for own, row in zip(self._natural, self._mix, strict=True)
        ]

    def values(self, vector: Float[Tensor, "*batch coordinate"]) -> dict[str, Tensor]:
        """Every parameter of the rig; fixed ones have no batch."""
        unmix = torch.as_tensor(self._unmix, dtype=vector.dtype, device=vector.device)
        return self._values_of((vector @ unmix.T).unbind(-1) if self.n else (), vector)

    def values_of_each(self, columns: Sequence[Float[Tensor, "*batch"]]) -> dict[str, Tensor]:
        """Every parameter of the rig, given the coordinates one by one: no value has a graph to coordinates that it does not depend on."""
        elementary = [
            columns[terms[0][0]] if terms == [(terms[0][0], 1.0)] else _sum(columns, terms)
            for terms in self._unmix_terms
        ]
        return self._values_of(elementary, columns[0])

    @cached_property
    def _unmix_terms(self) -> list[list[tuple[int, float]]]:
        """Terms of each row of the matrix: numbers of coordinates with their factors."""
        return [[(int(i), float(row[i])) for i in np.flatnonzero(row)] for row in self._unmix]

    def slopes_of_values(
        self, vector: Float[Tensor, " coordinate"]
    ) -> Float[Tensor, "coordinate continuous"]:
        """Derivatives of the value of every free parameter in the continuous coordinates."""
        with torch.no_grad():
            values = self.values(vector)
        own = [
            values[natural.name] if isinstance(natural, Logarithm) else vector.new_ones(())
            for natural in self._natural
        ]
        slopes = torch.diag(torch.stack(own)) if own else vector.new_zeros(0, 0)
        if len(coupled := self.coupled):
            names = [self.names[i] for i in coupled.tolist()]

            def of_coupled(some: Tensor) -> Tensor:
                values = self.values(vector.index_copy(0, coupled, some))
                return torch.stack([values[name] for name in names])

            slopes[coupled[:, None], coupled] = jacobian_of(of_coupled, vector[coupled])
        return slopes[:, : self.n_continuous]

    def _values_of(self, elementary: Sequence[Tensor], like: Tensor) -> dict[str, Tensor]:
        """Every parameter, given coordinates in which no number mixes with others."""
        values = dict(self._fixed(like.dtype, like.device))

        def resolve(name: str) -> Tensor:
            if name not in values:
                values[name] = self._value(name, elementary, resolve)
            return values[name]

        return {name: resolve(name) for name in self.rig.parameters}

    def vector(self, values: Mapping[str, Tensor | float]) -> Float[Tensor, "*batch coordinate"]:
        """Coordinates of given values of the parameters; those not given have their nominal values."""
        return self.unmixed(values) @ torch.as_tensor(self._mix).to(self.device).T

    def unmixed(self, values: Mapping[str, Tensor | float]) -> Float[Tensor, "*batch coordinate"]:
        """Coordinates before turns, length and thickness replace wire radius and loop counts; in these a `JointNormal` is stated."""
        nominal = self.rig.nominal_values()
        complete = {
            name: torch.as_tensor(values.get(name, nominal[name]), dtype=torch.float64, device=self.device)
            for name in self.rig.parameters
        }
        for name in self.rig.parameters:
            complete[name] = self._follow_tie(name, complete)
        columns = [own.coordinate(complete[own.name], complete.__getitem__) for own in self._natural]
        if not columns:
            return torch.zeros(0, dtype=torch.float64, device=self.device)
        return torch.stack(torch.broadcast_tensors(*columns), dim=-1)

    def bounds(self) -> tuple[Float[Tensor, " coordinate"], Float[Tensor, " coordinate"]]:
        """Smallest and largest value that the prior of each free parameter allows, in the parameter's unit."""
        priors = [parameter.prior for parameter in self.parameters if parameter.prior]
        lower, upper = ([getattr(prior, end) for prior in priors] for end in ("lower", "upper"))
        ends = torch.tensor([lower, upper], dtype=torch.float64, device=self.device)
        return ends[0], ends[1]

    def start(self) -> Float[Tensor, " coordinate"]:
        """Coordinates of the nominal values."""
        return self.vector({})

    @cached_property
    def scale(self) -> Float[Tensor, " coordinate"]:
        """Prior standard deviation of every coordinate, to first order about the nominal values."""
        nominal = self.rig.nominal_values()
        free_values = torch.tensor(
            [nominal[name] for name in self.names], dtype=torch.float64, device=self.device
        )
        if not self.n:
            return free_values
        jacobian = jacobian_of(
            lambda values: self.vector(dict(zip(self.names, values, strict=True))), free_values
        )
        sd = free_values.new_tensor([p.prior.sd for p in self.parameters if p.prior])
        return torch.sqrt(jacobian**2 @ sd**2)

    @cached_property
    def coupled(self) -> Int[Tensor, " coupled"]:
        """Continuous columns whose log prior may depend on others: of windings, of a prior together, and what others are tied to."""
        wound = {coil.name for coil in self.rig.wound}
        together = self.rig.joint.names if self.rig.joint else ()
        tied_to = {parameter.tie.to for parameter in self.rig.parameters.values() if parameter.tie}
        columns = [
            i
            for i, name in enumerate(self.names[: self.n_continuous])
            if name.partition(".")[0] in wound or name in tied_to or name in together
        ]
        return torch.tensor(columns, dtype=torch.int64, device=self.device)

    def log_prior(self, vector: Float[Tensor, "*batch coordinate"]) -> Float[Tensor, "*batch"]:
        """Log prior density of the coordinates, including the Jacobian determinant of the transform, up to a constant."""
        return self._joint_prior.log_density(self.values(vector), vector)

    @cached_property
    def _joint_prior(self) -> JointPrior:
        return JointPrior(self.rig, self.parameters, self._natural)

    def sample_prior(self, rng: np.random.Generator, size: int) -> Float[Tensor, "size coordinate"]:
        """Draws from the prior, as coordinates; loop counts are rounded to whole numbers that the prior allows, if there are any."""
        priors = {parameter.name: parameter.prior for parameter in self.parameters if parameter.prior}
        draws = {name: torch.as_tensor(prior.sample(rng, size)) for name, prior in priors.items()}
        if joint := self._joint_prior.joint:
            every = Coordinates(self.rig)  # loop counts by their logarithms
            elementary = every.unmixed(draws)
            columns = [every._column[name] for name in joint.names]
            elementary[:, columns] = self._joint_prior.sample_joint(rng, size)
            values = every._values_of(elementary.unbind(-1), elementary)
            draws |= {
                name: values[name].clamp(priors[name].lower, priors[name].upper) for name in joint.names
            }
        counts = [parameter.name for parameter in self.parameters if parameter.is_count]
        draws |= {name: torch.as_tensor(_whole(draws[name].numpy(), priors[name])) for name in counts}
        return self.vector(draws)

    def _fixed(self, dtype: torch.dtype, device: torch.device) -> dict[str, Tensor]:
        """Values of the parameters that are neither free nor tied, made once for each kind of tensor."""
        if (dtype, device) not in self._fixed_values:
            self._fixed_values[dtype, device] = {
                name: torch.tensor(parameter.value, dtype=dtype, device=device)
                for name, parameter in self.rig.parameters.items()
                if parameter.tie is None and name not in self._column
            }
        return self._fixed_values[dtype, device]

    def _value(self, name: str, elementary: Sequence[Tensor], resolve: Resolve) -> Tensor:
        parameter = self.rig.parameters[name]
        if parameter.tie is not None:
            return parameter.tie.factor * resolve(parameter.tie.to)
        column = self._column[name]
        return self._natural[column].value(elementary[column], resolve)

    def _follow_tie(self, name: str, values: Mapping[str, Tensor]) -> Tensor:
        tie = self.rig.parameters[name].tie
        return values[name] if tie is None else tie.factor * self._follow_tie(tie.to, values)

    def _natural_mix(self) -> np.ndarray:
        """Matrix that maps (log R_w, log N_a, log N_r) to (log thickness, log turns, log length) where all three are free."""
        mix = np.eye(self.n)
        if self.integer_counts:
            return mix
        for coil in self.rig.wound:
            names = [f"{coil.name}.{key}" for key in ("wire_radius_m", "axial_loops", "radial_loops")]
            ties = [self.rig.parameters[f"{coil.name}.{pitch}_pitch_m"].tie for pitch in ("axial", "radial")]
            if all(name in self._column for name in names) and all(
                tie and tie.to == names[0] for tie in ties
            ):
                wire, axial, radial = (self._column[name] for name in names)
                mix[wire, [wire, radial]] = 1.0
                mix[axial, [axial, radial]] = 1.0
                mix[radial] = 0.0
                mix[radial, [wire, axial]] = 1.0
        return mix


def _sum(columns: Sequence[Tensor], terms: Sequence[tuple[int, float]]) -> Tensor:
    """Sum of some columns, each times its factor."""
    return torch.stack([factor * columns[i] for i, factor in terms]).sum(0)


def _whole(draw: np.ndarray, prior: Prior) -> np.ndarray:
    """Draws of a loop count, at least 1, rounded to whole numbers inside the bounds of its prior; as drawn where there is none.

    Examples:
        >>> from estimator.rig.parameters import Uniform
        >>> _whole(np.array([3.4, 4.4]), Uniform(3.2, 4.5)), _whole(np.array([3.4]), Uniform(3.2, 3.8))
        (array([4., 4.]), array([3.4]))
    """
    lowest, highest = np.ceil(max(prior.lower, 1.0)), np.floor(prior.upper)
    return np.clip(np.round(draw), lowest, highest) if lowest <= highest else np.maximum(draw, 1.0)
