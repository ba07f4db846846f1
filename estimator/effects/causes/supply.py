"""What the supply delivers instead of the commanded current."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import WHEN, Kind, Quantity, Theta, normal, shape, since
from estimator.effects.circumstances import LEAST_STEP, Circumstances, Extent
from estimator.effects.stages import CurrentEffect, OneCoilCurrent
from estimator.rig.parameters import LogNormal
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

# Of the largest current; a twentieth apart, so that one lies near any limit between two settings.
LIMITED_AT = (0.99, 0.95, 0.9, 0.87, 0.83, 0.8, 0.75, 0.7, 0.65, 0.6, 0.55, 0.5, 0.45)
NO_LIMIT = 3.0  # times the largest current: beyond what the session commanded
RANGES = 12  # steps of the largest current at which a range may end


class CurrentGain(OneCoilCurrent):
    """The supply delivers a fixed multiple of the commanded current."""

    name: ClassVar[str] = "current_gain"
    words: ClassVar[str] = "the supply delivers a fixed multiple of the commanded current"
    source: ClassVar[str] = "read-back accuracy of bench supplies, 0.1 to 1 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of the current."""
        return (normal("excess", "1", 0.01),)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        return current_A * (1.0 + theta["excess"][..., None])


class CurrentOffset(OneCoilCurrent):
    """A constant current flows on top of the commanded one, also at zero."""

    name: ClassVar[str] = "current_offset"
    words: ClassVar[str] = "a constant current flows on top of the commanded one"
    source: ClassVar[str] = "offset of bipolar supplies, about 0.1 % of a range of 20 A"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Constant current on top of the commanded one, in A."""
        return (normal("offset_A", "A", max(0.02, 0.01 * extent.largest_current_A)),)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        return current_A + theta["offset_A"][..., None]


class CurrentDeadBand(OneCoilCurrent):
    """About zero the supply delivers nothing, and beyond it a constant less than commanded: a cross-over of two output stages."""

    name: ClassVar[str] = "current_dead_band"
    words: ClassVar[str] = "about zero the supply delivers nothing, and a constant less than commanded beyond"
    is_linear: ClassVar[bool] = False
    source: ClassVar[str] = "cross-over of bipolar amplifiers, 0.1 to 1 % of their range"
    never_negative: ClassVar[tuple[str, ...]] = ("band_A",)

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Current by which each direction falls short."""
        return (normal("band_A", "A", max(0.02, 0.01 * extent.largest_current_A)),)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried currents of two sizes: one size alone is a gain."""
        return _has_sizes(circumstances, place)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil; a negative band is a jump of the current at zero."""
        band_A = theta["band_A"][..., None]
        return torch.sign(current_A) * (current_A.abs() - band_A).clamp(min=0.0)


class CurrentAsymmetry(OneCoilCurrent):
    """Positive and negative currents have gains of their own: a bipolar supply has an output stage and a shunt for each."""

    name: ClassVar[str] = "current_asymmetry"
    words: ClassVar[str] = "the supply delivers another share of positive than of negative currents"
    is_linear: ClassVar[bool] = False
    source: ClassVar[str] = (
        "for each polarity a gain of its own: bench supplies 0.1 to 1 %, half bridges with a shunt each 1 to 3 %"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Excess of the gain of positive currents; negative ones lack as much."""
        return (normal("excess", "1", 0.015),)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried currents of both signs."""
        coil = [coil.name for coil in circumstances.rig.coils].index(place)
        current_A = circumstances.observations.history.current_A[:, coil]
        return bool((current_A > 0.0).any() and (current_A < 0.0).any())

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        return current_A + theta["excess"][..., None] * current_A.abs()


class CurrentCompression(OneCoilCurrent):
    """The larger the current, the more of it the supply lacks: it nears the limit of its voltage, or its shunt warms up at once."""

    name: ClassVar[str] = "current_compression"
    words: ClassVar[str] = "the supply lacks the more of a current, the larger it is"
    is_linear: ClassVar[bool] = False
    source: ClassVar[str] = "linearity of supplies near the limit of their voltage, 0.1 to 2 %"
    never_negative: ClassVar[tuple[str, ...]] = ("loss_per_A2",)

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share that is lost per square ampere."""
        return (normal("loss_per_A2", "1/A2", 0.01 / extent.largest_current_A**2),)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried currents of two sizes: one size alone is a gain."""
        return _has_sizes(circumstances, place)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        return current_A * (1.0 - theta["loss_per_A2"][..., None] * current_A**2)


class CurrentLimit(OneCoilCurrent):
    """The supply reaches the limit of its voltage: it delivers no more than some current, whatever is commanded.

    A limit that sinks while the coil warms up is that of the resistance, `coil_heating`.
    """

    name: ClassVar[str] = "current_limit"
    words: ClassVar[str] = "beyond some current the supply delivers no more, as at the limit of its voltage"
    is_linear: ClassVar[bool] = False
    source: ClassVar[str] = "any limit; the largest currents of the session show where it is"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Largest current that is delivered."""
        largest_A = extent.largest_current_A
        limited = shape("limit_A", "A", 0.1 * largest_A, NO_LIMIT * largest_A)
        return (Quantity("limit_A", "A", limited.prior, NO_LIMIT * largest_A),)

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Shares of the largest current of the coil."""
        sizes_A = _sizes_A(circumstances, place)
        largest_A = float(sizes_A[-1]) if len(sizes_A) else circumstances.largest_current_A
        return tuple({"limit_A": share * largest_A} for share in LIMITED_AT)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried currents of two sizes: one size alone is a gain."""
        return _has_sizes(circumstances, place)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        limit_A = theta["limit_A"][..., None]
        return torch.minimum(torch.maximum(current_A, -limit_A), limit_A)


class CurrentRange(OneCoilCurrent):
    """Below some current the supply works in another range, whose shunt or amplifier has a gain of its own."""

    name: ClassVar[str] = "current_range"
    words: ClassVar[str] = "below some current the supply works in another range, with another gain"
    is_linear: ClassVar[bool] = False
    source: ClassVar[str] = "ranges of supplies have gain errors of their own, 0.1 to 1 %"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Excess of the gain in the low range, and the current at which it ends."""
        return (
            normal("excess", "1", 0.01),
            shape("below_A", "A", 0.0, 2.0 * extent.largest_current_A, is_fixed=True),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Ends evenly over the currents of the coil, each in the middle between two sizes of them; half of the largest without sizes."""
        sizes_A = _sizes_A(circumstances, place)
        ends_A = sizes_A[-1:] * torch.arange(1.0, RANGES, dtype=sizes_A.dtype, device=sizes_A.device) / RANGES
        above = torch.searchsorted(sizes_A, ends_A).unique()
        above = above[above > 0]
        between_A = (0.5 * (sizes_A[above - 1] + sizes_A[above])).tolist()
        return tuple({"below_A": end_A} for end_A in between_A or [0.5 * circumstances.largest_current_A])

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the coil carried currents of two sizes: one size alone is a gain."""
        return _has_sizes(circumstances, place)

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        is_low = current_A.abs() < theta["below_A"][..., None]
        return current_A * (1.0 + theta["excess"][..., None] * is_low)


class CurrentStep(OneCoilCurrent):
    """From one instant on the coil carries less current, or has fewer turns that count."""

    name: ClassVar[str] = "current_step"
    words: ClassVar[str] = "from one instant on the coil carries less current, as after a shorted turn"
    source: ClassVar[str] = (
        "a shorted layer of a winding of 50 layers, 2 %; a supply that changes range, 0.1 to 1 %"
    )

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share that is lost, and the time since the session began at which it was."""
        return (normal("step", "1", 0.02), since(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Instants with readings before and after."""
        return tuple({"since_h": instant_h} for instant_h in circumstances.instants_h)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        return current_A * (1.0 - theta["step"][..., None] * circumstances.is_meanwhile(theta))


class CoilHeating(OneCoilCurrent):
    """The coil warms up by its own losses, and the current sags with its resistance (a supply at its voltage limit).

    While cold, at the coolest of the session, it carries what was commanded: whole loop counts leave no room for another reference.
    """

    name: ClassVar[str] = "coil_heating"
    words: ClassVar[str] = "the current sags while the coil warms up by its own losses"
    source: ClassVar[str] = (
        "copper gains 0.39 % of resistance a kelvin; coils of this size warm up by some kelvins"
    )
    never_negative: ClassVar[tuple[str, ...]] = ("loss_per_K", "loss_per_A2")

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative loss of current per kelvin of a thermometer, or per square ampere in the steady state; time constant of the latter."""
        tau = LogNormal(extent.duration_h, 1.5)
        return (
            normal("loss_per_K", "1/K", 4e-3),
            normal("loss_per_A2", "1/A2", 0.02 / extent.largest_current_A**2),
            Quantity("tau_h", "h", tau, extent.duration_h, is_shape=True),
        )

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Quick, slow, and slower than the session is long."""
        return tuple({"tau_h": share * circumstances.duration_h} for share in (0.08, 0.3, 1.0, 3.0))

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """Losses where a thermometer saw the coil warm up; the loss per kelvin where none did."""
        kelvin = circumstances.warming_K(place)
        has_warmed = kelvin is not None and bool(kelvin.max() > 0.0)
        return frozenset({"loss_per_A2", "tau_h"} if has_warmed else {"loss_per_K"})

    def beyond_the_moment(self, key: str) -> str | None:
        """Losses depend on the past; a thermometer reads the present."""
        return (
            None
            if key == "loss_per_K"
            else "the currents of a whole session, where loss_per_K depends on the temperature"
        )

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        loss = theta["loss_per_A2"][..., None] * circumstances.heat_A2(coil, theta["tau_h"])
        kelvin = circumstances.warming_K(circumstances.rig.coils[coil].name)
        if kelvin is not None:
            loss = loss + theta["loss_per_K"][..., None] * kelvin
        return current_A * (1.0 - loss)


class CurrentRemanence(OneCoilCurrent):
    """The coil acts as if a share of the current from which it last turned back still flowed: hysteresis of its core or its supply."""

    name: ClassVar[str] = "current_remanence"
    words: ClassVar[str] = "a share of the current before its last turn still acts"
    source: ClassVar[str] = "remanence of steel cores and screws, 0.1 to 2 % of the field they were in"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """What stays of the last local extreme of the current."""
        return (normal("share", "1", 0.01),)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the current of the coil has turned back."""
        coil = [coil.name for coil in circumstances.rig.coils].index(place)
        return bool(circumstances.last_turn_A(coil).any())

    def beyond_the_moment(self, key: str) -> str | None:
        """The way to a current is history."""
        return "which current flowed before"

    def delivered(
        self,
        current_A: Float[Tensor, "*#batch reading"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading"]:
        """Current in the coil."""
        return current_A + theta["share"][..., None] * circumstances.last_turn_A(coil)


class NeighbourCoil(CurrentEffect):
    """This coil carries a share of the other coils' currents, by coupling or leakage of its supply."""

    name: ClassVar[str] = "neighbour_coil"
    kind: ClassVar[Kind] = Kind.COIL
    words: ClassVar[str] = "this coil carries a share of its neighbours' currents"
    source: ClassVar[str] = "wide: nothing is specified for wiring"
    couples_coils: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Share of the summed current of the other coils."""
        return (normal("share", "1", 0.05),)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Every coil that has a neighbour."""
        return tuple(coil.name for coil in rig.coils) if len(rig.coils) > 1 else ()

    def apply(
        self,
        current_A: Float[Tensor, "*#batch reading coil"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Delivered currents."""
        neighbours_A = current_A.sum(-1) - current_A[..., coil]
        leak_A = theta["share"][..., None] * neighbours_A
        is_coil = (torch.arange(current_A.shape[-1], device=current_A.device) == coil).to(current_A.dtype)
        return current_A + leak_A[..., None] * is_coil


def _has_sizes(circumstances: Circumstances, place: str) -> bool:
    """Whether a coil carried currents of two sizes beside none."""
    sizes_A = _sizes_A(circumstances, place)
    return bool(len(sizes_A)) and bool(sizes_A[-1] - sizes_A[0] > LEAST_STEP * sizes_A[-1])


def _sizes_A(circumstances: Circumstances, place: str) -> Float[Tensor, " size"]:
    """Different sizes of the currents of a coil beside none, in order."""
    coil = [coil.name for coil in circumstances.rig.coils].index(place)
    sizes_A = circumstances.observations.history.current_A[:, coil].abs()
    different_A: Tensor = sizes_A[sizes_A > 0.0].unique()
    return different_A
