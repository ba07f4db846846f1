"""Readings that follow another formula than sums over the loops of a winding: another simulation made them."""

from __future__ import annotations

from estimator.effects.base import Theta, pure
from estimator.effects.stages import Field, Points, SourceEffect
from estimator.field.dipole import dipole_field
from estimator.field.literal import literal_field_per_ampere
from estimator.field.straight import MU0_OVER_4PI
from estimator.field.winding import Winding, field_of_loops, loops_of
from estimator.field.winding_shape import Rule

WEIGHT = pure(weight=1.0)  # of the other formula against the right one


@SourceEffect.cause(quantities=WEIGHT, can_begin=False)
def spherical_sum(points_coil_m: Points, winding: Winding, rule: Rule, theta: Theta) -> Field:
    """Readings and simulation differ by a sum of spherical components about different centres.

    Readings and simulation differ by the paper's literal sum, which adds spherical components of loops whose centres differ.

    A weight of 1 stands for readings that a literal simulation made. Where the simulation itself is literal (`field_sum:
    spherical_components` in the rig file), a weight of -1 takes that back: nature adds vectors.

    Source: 0, 1 or -1: which simulation made the data, and which one explains them (Osinde et al., eq 13).
    """
    right = field_of_loops(points_coil_m, loops_of(winding, rule), rule.steps)
    literal = literal_field_per_ampere(points_coil_m, winding, rule)
    return theta["weight"][..., None, None] * (literal - right)


@SourceEffect.cause(
    quantities=WEIGHT,
    can_begin=False,
    # In the middle of the winding the field of a dipole has no bound.
    concerns=lambda circumstances, place: not circumstances.has_sensor_in_bore(place),
)
def dipole_model(points_coil_m: Points, winding: Winding, rule: Rule, theta: Theta) -> Field:
    """The readings follow a point dipole, not a winding.

    The readings follow a point dipole at the middle of the winding instead of loops.

    Source: 0 or 1: which simulation made the data.
    """
    up = points_coil_m.new_tensor([0.0, 0.0, 1.0])
    from_middle_m = points_coil_m + 0.5 * winding.length_m[..., None, None] * up
    dipole = MU0_OVER_4PI * dipole_field(from_middle_m, winding.moment_m2[..., None, None] * up)
    loops = field_of_loops(points_coil_m, loops_of(winding, rule), rule.steps)
    return theta["weight"][..., None, None] * (dipole - loops)
