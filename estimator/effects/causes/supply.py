"""What the supply delivers instead of the commanded current."""

from __future__ import annotations

from collections.abc import Callable

from jaxtyping import Float

from estimator.effects.base import Quantities, Quantity, Starts, Theta, at_most, fixed, normal, pure
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.during import during, spell
from estimator.effects.history import LEAST_STEP
from estimator.effects.stages import Current, CurrentEffect, Currents, OneCoilCurrent
from estimator.rig.parameters import LogNormal
from estimator.tensors import Tensor, torch

# Of the largest current; a twentieth apart, so that one lies near any limit between two settings.
LIMITED_AT = (0.99, 0.95, 0.9, 0.87, 0.83, 0.8, 0.75, 0.7, 0.65, 0.6, 0.55, 0.5, 0.45)
NO_LIMIT = 1.1  # times the largest current: beyond what the session commanded
WHOLE_SESSION = "the currents of a whole session, where loss_per_K depends on the temperature"
RANGES = 12  # steps of the largest current at which a range may end


def _sizes_A(circumstances: Circumstances, coil: str) -> Float[Tensor, " size"]:
    """Different sizes of the currents of a coil beside none, in order."""
    sizes_A = circumstances.commanded_A(coil).abs()
    return sizes_A[sizes_A > 0.0].unique()


def _has_sizes(circumstances: Circumstances, place: str) -> bool:
    """Whether the coil carried currents of two sizes beside none: one size alone is a gain."""
    sizes_A = _sizes_A(circumstances, place)
    return bool(len(sizes_A)) and bool(sizes_A[-1] - sizes_A[0] > LEAST_STEP * sizes_A[-1])


def _missing(key: str) -> Callable[[Extent], Quantities]:
    """A constant current that is there or missing."""
    return lambda extent: (normal(key, "A", max(0.02, 0.01 * extent.largest_current_A)),)


@OneCoilCurrent.cause(quantities=pure(excess=0.01))
def current_gain(current_A: Current, theta: Theta) -> Current:
    """The supply delivers a fixed multiple of the commanded current.

    Source: read-back accuracy of bench supplies, 0.1 to 1 %.
    """
    return current_A * (1.0 + theta["excess"][..., None])


@OneCoilCurrent.cause(quantities=_missing("offset_A"))
def current_offset(current_A: Current, theta: Theta) -> Current:
    """A constant current flows on top of the commanded one.

    A constant current flows on top of the commanded one, also at zero.

    Source: offset of bipolar supplies, about 0.1 % of a range of 20 A.
    """
    return current_A + theta["offset_A"][..., None]


# Quantities: a negative band is a jump of the current at zero.
@OneCoilCurrent.cause(
    quantities=_missing("band_A"), concerns=_has_sizes, is_linear=False, never_negative=("band_A",)
)
def current_dead_band(current_A: Current, theta: Theta) -> Current:
    """About zero the supply delivers nothing, and a constant less than commanded beyond.

    About zero the supply delivers nothing, and beyond it a constant less than commanded: a cross-over of two output stages.

    Source: cross-over of bipolar amplifiers, 0.1 to 1 % of their range.
    """
    return torch.sign(current_A) * (current_A.abs() - theta["band_A"][..., None]).clamp(min=0.0)


def _has_both_signs(circumstances: Circumstances, place: str) -> bool:
    current_A = circumstances.commanded_A(place)
    return bool((current_A > 0.0).any() and (current_A < 0.0).any())


# Quantities: of the gain of positive currents; negative ones lack as much.
@OneCoilCurrent.cause(quantities=pure(excess=0.015), concerns=_has_both_signs, is_linear=False)
def current_asymmetry(current_A: Current, theta: Theta) -> Current:
    """The supply delivers another share of positive than of negative currents.

    Positive and negative currents have gains of their own: a bipolar supply has an output stage and a shunt for each.

    Source: for each polarity a gain of its own: bench supplies 0.1 to 1 %, half bridges with a shunt each 1 to 3 %.
    """
    return current_A + theta["excess"][..., None] * current_A.abs()


@OneCoilCurrent.cause(
    quantities=lambda extent: (normal("loss_per_A2", "1/A2", 0.01 / extent.largest_current_A**2),),
    concerns=_has_sizes,
    is_linear=False,
    never_negative=("loss_per_A2",),
)
def current_compression(current_A: Current, theta: Theta) -> Current:
    """The supply delivers too little, and a larger share is missing the larger the current is.

    The larger the current, the more of it the supply lacks: it nears the limit of its voltage, or its shunt warms up at once.

    Source: linearity of supplies near the limit of their voltage, 0.1 to 2 %.
    """
    return current_A * (1.0 - theta["loss_per_A2"][..., None] * current_A**2)


def _between(sizes_A: Float[Tensor, " size"], at_A: Float[Tensor, " at"]) -> list[float]:
    """Middles between two sizes of currents, about each of some currents: nothing tells places between the same two sizes apart."""
    above = torch.searchsorted(sizes_A, at_A).unique()
    above = above[(above > 0) & (above < len(sizes_A))]
    return (0.5 * (sizes_A[above - 1] + sizes_A[above])).tolist()


def _limits(circumstances: Circumstances, place: str) -> Starts:
    """Limits between all pairs of sizes that lie beside each other, among the larger half of them."""
    sizes_A = _sizes_A(circumstances, place)
    limits_A = _between(sizes_A, sizes_A[-1:] * sizes_A.new_tensor(LIMITED_AT))
    return tuple({"limit_A": limit_A} for limit_A in limits_A or [0.5 * circumstances.largest_current_A])


@OneCoilCurrent.cause(
    quantities=lambda extent: (at_most("limit_A", "A", 0.1, NO_LIMIT, extent.largest_current_A),),
    starts=_limits,
    concerns=_has_sizes,
    is_linear=False,
)
def current_limit(current_A: Current, theta: Theta) -> Current:
    """Beyond some current the supply delivers no more, as at the limit of its voltage.

    The supply reaches the limit of its voltage: it delivers no more than some current, whatever is commanded.

    A limit that sinks while the coil warms up is that of the resistance, `coil_heating`.

    Source: any limit; the largest currents of the session show where it is.
    """
    limit_A = theta["limit_A"][..., None]
    return torch.minimum(torch.maximum(current_A, -limit_A), limit_A)


def _ends_of_ranges(circumstances: Circumstances, place: str) -> Starts:
    """Ends evenly over the currents of the coil, each in the middle between two sizes of them; half of the largest without sizes."""
    sizes_A = _sizes_A(circumstances, place)
    ends_A = sizes_A[-1:] * torch.arange(1.0, RANGES, dtype=sizes_A.dtype, device=sizes_A.device) / RANGES
    between_A = _between(sizes_A, ends_A)
    return tuple({"below_A": end_A} for end_A in between_A or [0.5 * circumstances.largest_current_A])


# Quantities: excess of the gain in the low range, and the current at which it ends.
@OneCoilCurrent.cause(
    quantities=lambda extent: (
        normal("excess", "1", 0.01),
        fixed("below_A", "A", 0.0, 2.0 * extent.largest_current_A),
    ),
    starts=_ends_of_ranges,
    concerns=_has_sizes,
    is_linear=False,
)
def current_range(current_A: Current, theta: Theta) -> Current:
    """Below some current the supply works in another range, with another gain.

    Below some current the supply works in another range, whose shunt or amplifier has a gain of its own.

    Source: ranges of supplies have gain errors of their own, 0.1 to 1 %.
    """
    is_low = current_A.abs() < theta["below_A"][..., None]
    return current_A * (1.0 + theta["excess"][..., None] * is_low)


@OneCoilCurrent.cause(
    quantities=pure(step=0.02)  # share that is lost
)
def _current_loss(current_A: Current, theta: Theta) -> Current:
    """The coil carries less current.

    The coil carries less current, or has fewer turns that count.

    Source: a shorted layer of a winding of 50 layers, 2 %; a supply that changes range, 0.1 to 1 %.
    """
    return current_A * (1.0 - theta["step"][..., None])


@during(_current_loss)
def current_step() -> None:
    """From one instant on the coil carries less current, as after a shorted turn.

    From one instant on the coil carries less current, or has fewer turns that count.
    """


@spell(current_step)
def current_spell() -> None:
    """For a while the coil carries another share of its current.

    For a while the coil carries less current: another range of its supply, a bad contact.

    Source: a supply in another range, a contact that warms: 0.1 to 2 %.
    """


# Quantities: what stays of the last local extreme of the current.
@OneCoilCurrent.cause(
    quantities=pure(share=0.01),
    concerns=lambda circumstances, place: circumstances.has_turned_back(place),
    depends_on="which current flowed before",
)
def current_remanence(current_A: Current, theta: Theta, circumstances: Circumstances, coil: int) -> Current:
    """A share of the current before its last turn still acts.

    The coil acts as if a share of the current from which it last turned back still flowed: hysteresis of its core or its supply.

    Source: remanence of steel cores and screws, 0.1 to 2 % of the field they were in.
    """
    return current_A + theta["share"][..., None] * circumstances.last_turn_A(coil)


def _losses(extent: Extent) -> Quantities:
    """Relative loss of current per kelvin of a thermometer, or per square ampere in the steady state; time constant of the latter."""
    return (
        normal("loss_per_K", "1/K", 4e-3),
        normal("loss_per_A2", "1/A2", 0.02 / extent.largest_current_A**2),
        Quantity("tau_h", "h", LogNormal(extent.duration_h, 1.5), extent.duration_h, is_shape=True),
    )


def _unseen_losses(circumstances: Circumstances, place: str) -> frozenset[str]:
    """Losses where a thermometer saw the coil warm up; the loss per kelvin where none did."""
    kelvin = circumstances.warming_K(place)
    has_warmed = kelvin is not None and bool(kelvin.max() > 0.0)
    return frozenset({"loss_per_A2", "tau_h"} if has_warmed else {"loss_per_K"})


@OneCoilCurrent.cause(
    quantities=_losses,
    starts=lambda circumstances: tuple(
        {"tau_h": share * circumstances.duration_h} for share in (0.08, 0.3, 1.0, 3.0)
    ),
    unseen=_unseen_losses,
    # Losses depend on the past; a thermometer reads the present.
    beyond_the_moment=lambda key: None if key == "loss_per_K" else WHOLE_SESSION,
    never_negative=("loss_per_K", "loss_per_A2"),
)
def coil_heating(current_A: Current, theta: Theta, circumstances: Circumstances, coil: int) -> Current:
    """The current sags while the coil warms up by its own losses.

    The coil warms up by its own losses, and the current sags with its resistance (a supply at its voltage limit).

    While cold, at the coolest of the session, it carries what was commanded: whole loop counts leave no room for another reference.

    Source: copper gains 0.39 % of resistance a kelvin; coils of this size warm up by some kelvins.
    """
    loss = theta["loss_per_A2"][..., None] * circumstances.heat_A2(coil, theta["tau_h"])
    kelvin = circumstances.warming_K(circumstances.rig.coils[coil].name)
    if kelvin is not None:
        loss = loss + theta["loss_per_K"][..., None] * kelvin
    return current_A * (1.0 - loss)


# Quantities: of the summed current of the other coils.
@CurrentEffect.cause(
    quantities=pure(share=0.05),
    places=lambda rig: tuple(coil.name for coil in rig.coils) if len(rig.coils) > 1 else (),
    couples_coils=True,
)
def neighbour_coil(current_A: Currents, theta: Theta, coil: int) -> Currents:
    """This coil carries a share of its neighbours' currents.

    This coil carries a share of the other coils' currents, by coupling or leakage of its supply.

    Source: wide: nothing is specified for wiring.
    """
    neighbours_A = current_A.sum(-1) - current_A[..., coil]
    leak_A = theta["share"][..., None] * neighbours_A
    is_coil = (torch.arange(current_A.shape[-1], device=current_A.device) == coil).to(current_A.dtype)
    return current_A + leak_A[..., None] * is_coil
