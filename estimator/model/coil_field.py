"""The field of one ampere in a coil, whatever is known of it: a winding, solid harmonics, or magnetic charges on a box.

Each kind says where it has no field, and why.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Bool, Float, Int

from estimator.errors import InvalidInput
from estimator.field.charged_box import charged_box_field, multipole_field
from estimator.field.coil import AnyWinding, field_of_coil
from estimator.field.harmonics import exterior_field, interior_field
from estimator.field.node_sum import SumMode
from estimator.field.winding_shape import Rule
from estimator.model.bodies import winding_of
from estimator.rig import bodies
from estimator.rig.coordinates import Values
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

# Share of the margin: 1.5 spacings off the charges, where they pass for a layer to a part in ten thousand.
CLEAR_SHARE = 0.5
ROUNDING = 1e-9  # of a multipole's distance from the box, whose nearest point is still fit for use
MOST_RADII = 3.0  # farther out a term of degree 8 is beyond 2000 times its amplitude, whose prior then says nothing: likely another unit

Points = Float[Tensor, "*#batch point 3"]
Forbidden = Bool[Tensor, "*batch point"]


class CoilField(ABC):
    """Field of one coil at some values of the rig's numbers, at points of the coil frame."""

    @property
    def winding(self) -> AnyWinding | None:
        """Its winding; None where that is not known."""
        return None

    @property
    def has_zones(self) -> bool:
        """Whether points may have rules by their distance (zones), which hold for loops that add as vectors."""
        return False

    @abstractmethod
    def by(self, rule: Rule | None, mode: SumMode = SumMode.PLAIN) -> Callable[[Tensor], Tensor]:
        """Field of one ampere in T/A as a function of points; free of divergence and curl.

        Args:
            rule: That stands for the loops of a winding; None where there is none.
            mode: How loops are summed.
        """

    @abstractmethod
    def has_none(self, points_coil_m: Points) -> Forbidden:
        """Whether the coil has no field at points: inside a winding, or among other sources."""

    @abstractmethod
    def rules(self, points_coil_m: Points) -> list[tuple[str, Forbidden]]:
        """Rules on where sensors must lie, in words, and which points break each."""


@dataclass(frozen=True)
class FieldOfWinding(CoilField):
    """Field of a winding of any shape, with its leads."""

    coil: bodies.WoundCoil
    shape: AnyWinding

    @property
    def winding(self) -> AnyWinding:
        """Its winding."""
        return self.shape

    @property
    def has_zones(self) -> bool:
        """Whether loops add as vectors."""
        return self.coil.field_sum is bodies.FieldSum.VECTORS

    def by(self, rule: Rule | None, mode: SumMode = SumMode.PLAIN) -> Callable[[Tensor], Tensor]:
        """Field by the sum that the rig file selects; the loops that stand for the winding are found once."""
        assert rule is not None  # see `MeasurementModel.choose_rules`
        return field_of_coil(self.coil, self.shape, rule, mode)

    def has_none(self, points_coil_m: Points) -> Forbidden:
        """Inside the winding."""
        return self.shape.distance_m(points_coil_m) <= 0.0

    def rules(self, points_coil_m: Points) -> list[tuple[str, Forbidden]]:
        """Outside the winding."""
        return [(f"outside the winding of {self.coil.name}", self.has_none(points_coil_m))]


@dataclass(frozen=True)
class FieldOfHarmonics(CoilField):
    """Solid harmonics about the origin, linear in their amplitudes; outside, they are singular at the origin.

    References: Jackson, Classical Electrodynamics, 3rd ed., sections 3.3 and 4.1.
    """

    coil: bodies.HarmonicCoil
    amplitudes: Float[Tensor, "*#batch amplitude"]
    radius_m: Float[Tensor, "*#batch"]

    def by(self, rule: Rule | None, mode: SumMode = SumMode.PLAIN) -> Callable[[Tensor], Tensor]:
        """Field of sources outside the ball (interior), or inside it (exterior)."""
        sizes = [len(own) for own in self.coil.amplitudes.values()]
        by_degree = dict(zip(self.coil.amplitudes, self.amplitudes.split(sizes, dim=-1), strict=True))
        field = interior_field if self.coil.region is bodies.Region.INTERIOR else exterior_field
        return lambda points_coil_m: field(points_coil_m / self.radius_m[..., None, None], by_degree)

    def has_none(self, points_coil_m: Points) -> Forbidden:
        """Among the sources of an exterior field."""
        distance_m: Tensor = points_coil_m.norm(dim=-1)
        if self.coil.region is bodies.Region.INTERIOR:
            return torch.zeros_like(distance_m, dtype=torch.bool)
        return distance_m <= self.radius_m[..., None]

    def rules(self, points_coil_m: Points) -> list[tuple[str, Forbidden]]:
        """Outside the ball of all sources, or at most a little outside the ball without sources."""
        where = f"of {self.coil.name}, {float(self.radius_m) * 1e3:.6g} mm"
        outside = f"outside the reference_radius {where}, which holds all its sources"
        rules = [(outside, self.has_none(points_coil_m))]
        if self.coil.region is bodies.Region.INTERIOR:
            is_far = points_coil_m.norm(dim=-1) > MOST_RADII * self.radius_m
            rules.append((f"within {MOST_RADII:g} times the reference_radius {where}", is_far))
        return rules


@dataclass(frozen=True)
class FieldOfCharges(CoilField):
    """Charges on a box and multipoles beside it, linear in their amplitudes."""

    coil: bodies.EquivalentSourceCoil
    amplitudes: Float[Tensor, "*batch amplitude"]

    def by(self, rule: Rule | None, mode: SumMode = SumMode.PLAIN) -> Callable[[Tensor], Tensor]:
        """Field of all of them; charges and multipoles are singular where they stand."""
        return self._per_ampere

    def _per_ampere(self, points_coil_m: Tensor) -> Tensor:
        coil, n = self.coil, self.coil.n_charges
        charges, multipoles = self.amplitudes[..., :n], self.amplitudes[..., n:]
        field_T = charged_box_field(points_coil_m, coil.charged_half_m, coil.intervals, charges)
        if coil.multipoles_m:
            places_m, gaps_m = map(points_coil_m.new_tensor, (coil.multipoles_m, coil.multipole_gaps_m))
            field_T = field_T + multipole_field(points_coil_m, places_m, gaps_m, multipoles)
        return field_T

    def has_none(self, points_coil_m: Points) -> Forbidden:
        """Near charges or beyond them, or near a multipole."""
        return self._is_beyond_box(points_coil_m) | self._is_near_multipole(points_coil_m)

    def rules(self, points_coil_m: Points) -> list[tuple[str, Forbidden]]:
        """Within the box, or a little beyond, and not near a multipole."""
        half = " x ".join(f"{2e3 * half_m:.6g}" for half_m in self.coil.half_m)
        beyond = f"no more than {CLEAR_SHARE:g} of the margin, {self.coil.margin_m * 1e3:.6g} mm, beyond"
        return [
            (f"{beyond} the box of {self.coil.name}, {half} mm", self._is_beyond_box(points_coil_m)),
            (
                f"no nearer to a multipole of {self.coil.name} than its box does",
                self._is_near_multipole(points_coil_m),
            ),
        ]

    def _is_beyond_box(self, points_coil_m: Points) -> Forbidden:
        reach_m = points_coil_m.new_tensor(self.coil.half_m) + CLEAR_SHARE * self.coil.margin_m
        return (points_coil_m.abs() > reach_m).any(dim=-1)

    def _is_near_multipole(self, points_coil_m: Points) -> Forbidden:
        is_near = torch.zeros_like(points_coil_m[..., 0], dtype=torch.bool)
        for place_m, gap_m in zip(self.coil.multipoles_m, self.coil.multipole_gaps_m, strict=True):
            distance_m = (points_coil_m - points_coil_m.new_tensor(place_m)).norm(dim=-1)
            is_near = is_near | (distance_m < (1.0 - ROUNDING) * gap_m)
        return is_near


def coil_field(rig: Rig, coil: bodies.AnyCoil, values: Values) -> CoilField:
    """The field of a coil at these values of the rig's numbers, with what its effects make of a winding."""
    if isinstance(coil, bodies.UnwoundCoil):
        return unwound_field(coil, values)
    return FieldOfWinding(coil, winding_of(rig, coil, values))


def unwound_field(coil: bodies.UnwoundCoil, values: Values) -> CoilField:
    """The field of a coil whose winding is not known."""
    names = [name for names in coil.amplitudes.values() for name in names]
    each = torch.stack(torch.broadcast_tensors(*(values[name] for name in names)), dim=-1)
    if isinstance(coil, bodies.EquivalentSourceCoil):
        return FieldOfCharges(coil, each)
    return FieldOfHarmonics(coil, each, values[f"{coil.name}.reference_radius_m"])


def refuse(
    rules: list[tuple[str, Bool[Tensor, "..."]]],
    rows: Int[Tensor, " row"],
    pose_row: Int[Tensor, " reading"],
    line: Int[Tensor, " reading"] | None,
    rig: str,
    is_nominal: bool,
) -> None:
    """Refuse sensors where a coil has no field.

    Args:
        rules: Where sensors must lie, and at which poses they do not.
        rows: Numbers of these poses among the distinct ones.
        pose_row: Distinct pose of each reading.
        line: Line of the file of each reading, where there is one.
        rig: Name of the rig.
        is_nominal: Whether numbers are those of the rig file; else a fit found them.
    Raises:
        InvalidInput: A sensor stands there.
    """
    values, cure = (
        ("the rig's nominal values", "correct where the rig file puts the sensor or the coil")
        if is_nominal
        else (
            "the fitted values",
            "fields, places or currents may be in another unit, frame or sign than stated; run coilcal diagnose",
        )
    )
    for rule, is_refused in rules:
        refused = is_refused.nonzero().flatten()
        if len(refused):
            reading = int(torch.isin(pose_row, rows[refused]).nonzero().flatten()[0])
            first = f"at reading {reading}" if line is None else f"in line {int(line[reading])}"
            raise InvalidInput(
                f"sensors must lie {rule}; at {values} {len(refused)} of {len(rows)} poses do not, the first {first}: {cure} (rig {rig!r})"
            )
