"""What the formats with a model write: the coils of one calibration, or of several as one magnet, in plain numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from jaxtyping import Float

from estimator.errors import InvalidInput
from estimator.export.calibrated import Calibrated
from estimator.export.labels import origin_of, points_about, regions_of
from estimator.export.linearised import CoilChange, Linearised, linearised
from estimator.export.plain_model import PlainCoil, PlainModel, PlainMover, plain_model
from estimator.rig.bodies import AnyCoil
from estimator.tensors import Tensor, torch


@dataclass(frozen=True)
class Magnet:
    """Coils of some calibrations.

    Attributes:
        parts: Calibrations, each with the coils that it is responsible for. Poses are in the same world frame.
        coils: Names of the coils, in the order of the currents.
    """

    parts: tuple[Calibrated, ...]
    coils: tuple[str, ...]

    @classmethod
    def of(cls, calibrated: Calibrated) -> Magnet:
        """The coils of one calibration."""
        return cls((calibrated,), tuple(coil.name for coil in calibrated.rig.coils))

    @property
    def name(self) -> str:
        """Name of the rig, or the names of all rigs."""
        return " and ".join(dict.fromkeys(part.rig.name for part in self.parts))

    @property
    def only(self) -> Calibrated | None:
        """The calibration, if there is only one."""
        return self.parts[0] if len(self.parts) == 1 else None

    @cached_property
    def home(self) -> Mapping[str, tuple[Calibrated, AnyCoil]]:
        """The calibration and the description of each coil, by its name."""
        return {coil.name: (part, coil) for part in self.parts for coil in part.rig.coils}

    def model(self, to: str, only_round: bool = False) -> PlainModel:
        """The model in plain numbers.

        Args:
            to: What is exported to, for the message.
            only_round: It can express neither windings with straight sides nor leads.
        Raises:
            InvalidInput: A rig has something that the numbers cannot express.
        """
        models = [plain_model(part.rig, part.best_values(), to, only_round) for part in self.parts]
        return joined(models, self.coils, self.name)

    @cached_property
    def changes(self) -> Linearised:
        """How the model moves along independent directions of the posteriors; errors of calibrations are independent."""
        each = [linearised(part) for part in self.parts]
        names = [[coil.name for coil in part.rig.coils] for part in self.parts]
        of_coil = {
            name: (number, changes.coils[position])
            for number, (changes, here) in enumerate(zip(each, names, strict=True))
            for position, name in enumerate(here)
        }
        n = len(self.coils)
        delivered, offset = [], []
        for changes, here in zip(each, names, strict=True):
            rows = torch.tensor([self.coils.index(name) for name in here])
            gains, offsets = (torch.zeros(changes.n_directions, *shape).double() for shape in ((n, n), (n,)))
            gains[:, rows[:, None], rows] = changes.delivered_A_per_A
            offsets[:, rows] = changes.offset_A
            delivered.append(gains)
            offset.append(offsets)
        counts = [changes.n_directions for changes in each]
        return Linearised(
            tuple(_among(change, number, counts) for number, change in map(of_coil.__getitem__, self.coils)),
            torch.cat(delivered),
            torch.cat(offset),
            torch.cat([changes.background_T for changes in each]),
        )

    @property
    def regions(self) -> list[str]:
        """Extent of the readings about each coil, a sentence each, in mm in the coil's frame."""
        return [line for part in self.parts for line in regions_of(part)]

    @property
    def origin(self) -> str:
        """Sessions, rigs and code behind it, in one line."""
        return "; ".join(map(origin_of, self.parts))

    def region_m(self, name: str) -> Float[Tensor, "reading 3"]:
        """Positions of the sensors in the frame of a coil, at readings with current in it."""
        return points_about(*self.home[name])


def joined(models: Sequence[PlainModel], coils: Sequence[str], name: str) -> PlainModel:
    """Some models as one: no supply drives a coil of another model, and fields of rooms add up.

    Args:
        models: Each with coils of its own. A mover of several models is the same one.
        coils: Names of the coils in the wanted order.
        name: Of the whole.
    Raises:
        InvalidInput: Models have different movers of one name.
    """
    movers: dict[str, PlainMover] = {}
    for model in models:
        for mover in model.movers:
            if movers.setdefault(mover.name, mover) != mover:
                raise InvalidInput(
                    f"mover {mover.name} must be the same in all calibrations; received two kinds of it"
                )
    order = list(movers)
    by_name: dict[str, PlainCoil] = {}
    n = len(coils)
    delivered, offset_A = torch.zeros(n, n, dtype=torch.float64), torch.zeros(n, dtype=torch.float64)
    for model in models:
        rows = torch.tensor([list(coils).index(coil.name) for coil in model.coils])
        delivered[rows[:, None], rows] = model.delivered_A_per_A
        offset_A[rows] = model.offset_A
        for coil in model.coils:
            mover_number = order.index(model.movers[coil.mover].name) if coil.mover >= 0 else -1
            by_name[coil.name] = replace(coil, mover=mover_number)
    background_T = torch.stack([model.background_T for model in models]).sum(0)
    return PlainModel(
        name,
        tuple(by_name[coil] for coil in coils),
        tuple(movers.values()),
        delivered,
        offset_A,
        background_T,
    )


def _among(change: CoilChange, number: int, counts: Sequence[int]) -> CoilChange:
    """Changes of a coil along its own directions, and none along those of other calibrations."""

    def padded(rows: Tensor) -> Tensor:
        width = rows.shape[-1]
        before, after = sum(counts[:number]), sum(counts[number + 1 :])
        return torch.cat((rows.new_zeros(before, width), rows, rows.new_zeros(after, width)))

    return CoilChange(padded(change.winding), padded(change.base), padded(change.flange))
