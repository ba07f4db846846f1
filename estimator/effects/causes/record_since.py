"""Mistakes of the record that begin in mid-session: a plug turned, cables exchanged, a reading lost.

Each is one of `effects.causes.record` and `effects.causes.pose_record` from an instant on. The instant lies between two readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from jaxtyping import Float

from estimator.effects.base import WHEN, Kind, Quantity, Theta, since, switch
from estimator.effects.causes.pose_record import RowsShifted
from estimator.effects.causes.record import MOST_BODIES, AxesSwapped, CurrentSign
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import CurrentEffect
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch


class AxesSwappedSince(AxesSwapped):
    """From one instant on the sensor's axes are in another order or direction: it was taken out and put back turned over."""

    name: ClassVar[str] = "axes_swapped_since"
    words: ClassVar[str] = "from one instant on the sensor's axes are in another order or direction"
    source: ClassVar[str] = "47 signed permutations"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Quantities of `axes_swapped`, and the time since the session began from which on they hold, in h."""
        return (*super().quantities(extent), since(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Permutations of `axes_swapped`, and the reversal of all three axes, each from each instant on."""
        reversal = {f"{axis}_reads": -(i + 1.0) for i, axis in enumerate("xyz")}
        return _at_instants((*super().starts(circumstances, place), reversal), circumstances)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""
        swapped_T = super().apply(field_sensor_T, theta, circumstances, sensor)
        return torch.where(circumstances.is_meanwhile(theta)[..., None], swapped_T, field_sensor_T)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Every component is read once."""
        return super().broken_rule({key: value for key, value in values.items() if key != "since_h"})


class CurrentSignSince(CurrentSign):
    """From one instant on the leads of a coil are exchanged."""

    name: ClassVar[str] = "current_sign_since"
    words: ClassVar[str] = "from one instant on the coil is connected the other way round"
    is_structural: ClassVar[bool] = False

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Sign of the current from then on, and the time since the session began."""
        return (*super().quantities(extent), since(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Reversed, from each instant on."""
        return _at_instants(super().starts(circumstances, place), circumstances)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def apply(
        self,
        current_A: Float[Tensor, "*#batch reading coil"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Delivered currents."""
        reversed_A = super().apply(current_A, theta, circumstances, coil)
        return torch.where(circumstances.is_meanwhile(theta)[..., None], reversed_A, current_A)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """A sign is a sign."""
        return super().broken_rule({"sign": values["sign"]})


class CoilsExchangedSince(CurrentEffect):
    """From one instant on two coils are connected in each other's place."""

    name: ClassVar[str] = "coils_exchanged_since"
    kind: ClassVar[Kind] = Kind.COIL
    words: ClassVar[str] = "from one instant on this coil and another are connected in each other's place"
    source: ClassVar[str] = "any two coils"
    is_record_mistake: ClassVar[bool] = True
    exchanges_coils: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """How many entries later the other coil stands in the rig file, and the time since the session began from which on, in h."""
        return (switch("later_by", 0.0, MOST_BODIES, 0.0), since(extent))

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Coils that another one follows in the rig file."""
        return tuple(coil.name for coil in rig.coils[:-1])

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Each of the coils that come later in the rig file, from each instant on."""
        names = [coil.name for coil in circumstances.rig.coils]
        n_later = len(names) - 1 - names.index(place)
        return _at_instants([{"later_by": float(n)} for n in range(1, n_later + 1)], circumstances)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def apply(
        self,
        current_A: Float[Tensor, "*#batch reading coil"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Delivered currents."""
        index = torch.arange(current_A.shape[-1], device=current_A.device)
        other = (coil + theta["later_by"][..., None].round().long()).clamp(max=len(index) - 1)
        source = torch.where(index == coil, other, torch.where(index == other, coil, index))
        current_A, source = torch.broadcast_tensors(current_A, source[..., None, :])
        exchanged_A = current_A.gather(-1, source)
        return torch.where(circumstances.is_meanwhile(theta)[..., None], exchanged_A, current_A)

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Coils are counted in whole numbers."""
        later_by = values["later_by"]
        is_count = later_by >= 0.0 and float(later_by).is_integer()
        return None if is_count else ("later_by", "must be a whole number of coils, from 0")


class RowsShiftedSince(RowsShifted):
    """From one instant on fields stand beside other rows: a trigger was missed, or a reading written twice, when two files were joined."""

    name: ClassVar[str] = "rows_shifted_since"
    words: ClassVar[str] = (
        "from one instant on fields stand some rows beside the poses and currents that they belong to"
    )
    source: ClassVar[str] = "readings lost (negative) or written twice (positive), two at most"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Rows by which fields come late from then on, and the time since the session began."""
        return (*super().quantities(extent), since(extent))

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Late and early, from each instant on."""
        return _at_instants(super().starts(circumstances, place), circumstances)

    def beyond_the_moment(self, key: str) -> str | None:
        """An instant needs a session to lie in."""
        return WHEN

    def late_since_h(self, values: Mapping[str, float]) -> float:
        """Time since the session began from which on rows are shifted, in h."""
        return values["since_h"]

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """Rows are whole."""
        return super().broken_rule({"rows": values["rows"]})


def _at_instants(
    starts: Sequence[Mapping[str, float]], circumstances: Circumstances
) -> tuple[dict[str, float], ...]:
    """The starts from each instant on."""
    instants_h = circumstances.coarse_instants_h
    return tuple({**start, "since_h": instant_h} for start in starts for instant_h in instants_h)
