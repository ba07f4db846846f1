"""The contract of an effect: one named cause of a difference between simulation and measurement.

An effect is declared once: where it acts, which quantities say how large it is, what they are when nothing is wrong (null), how large
they are in laboratories (prior), and one `apply`. Simulating with it, screening for it, fitting it and carrying it in a calibrated model
all come from that declaration. A rig holds effects as entries `cause[place]`, whose quantities are parameters like any others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimator.effects.circumstances import Circumstances, Extent
from estimator.field.magnetised import Rings
from estimator.field.winding import Rule, Winding
from estimator.frames import Transform
from estimator.rig.parameters import LogNormal, Normal, Prior, Uniform
from estimator.rig.rig import Body, Coil, Mover, Rig

Theta = Mapping[str, Tensor]  # quantities by key, each with the batch of the hypothesis


class Kind(StrEnum):
    """What an effect belongs to; a rig with several of them has the effect several times."""

    COIL = "coil"
    SENSOR = "sensor"
    MOVER = "mover"
    ROOM = "room"
    RECORD = "record"


@dataclass(frozen=True)
class Quantity:
    """One number of an effect.

    Attributes:
        key: Name with its SI unit as suffix; pure numbers have none.
        unit: SI unit; "1" for pure numbers.
        prior: What is known of it where the effect is present.
        null: Value at which it changes nothing.
        is_shape: Says where or how the effect acts and does nothing by itself: a position, a time constant.
        is_fixed: A shape that a fit leaves where the start has put it: an instant, an axis.
    """

    key: str
    unit: str
    prior: Prior
    null: float = 0.0
    is_shape: bool = False
    is_fixed: bool = False

    @property
    def is_positive(self) -> bool:
        """Fitted as a logarithm."""
        return isinstance(self.prior, LogNormal)


def normal(key: str, unit: str, sd: float, null: float = 0.0) -> Quantity:
    """A quantity that scatters normally about its null."""
    return Quantity(key, unit, Normal(null, sd), null)


def at_least_zero(key: str, unit: str, sd: float) -> Quantity:
    """A quantity that cannot be negative, half-normal above zero."""
    return Quantity(key, unit, Normal(0.0, sd, lower=0.0))


def triple(keys: Iterable[str], suffix: str, unit: str, sd: float) -> tuple[Quantity, ...]:
    """Quantities alike but for their first letters: `triple("xyz", "_T", "T", 1e-5)`."""
    return tuple(normal(f"{key}{suffix}", unit, sd) for key in keys)


def shape(key: str, unit: str, lower: float, upper: float, is_fixed: bool = False) -> Quantity:
    """A shape that may lie anywhere in a range."""
    return Quantity(key, unit, Uniform(lower, upper), 0.5 * (lower + upper), True, is_fixed)


class Effect(ABC):
    """A cause. Subclasses say at which stage of the measurement model they act.

    Attributes:
        name: Stable name of the cause, as in `diagnosis.json`.
        kind: What it belongs to.
        words: What has happened, in a few words, for reports.
        source: Where the width of its priors comes from.
        is_record_mistake: It is there or not, and makes the readings absurd unless undone. All its starts are tried before any other cause.
        idealises: What it is a simplified picture of. Where a session needs two pictures of the same thing, neither is true.
        is_linear: The field stays proportional to the currents.
    """

    name: ClassVar[str]
    kind: ClassVar[Kind]
    words: ClassVar[str]
    source: ClassVar[str]
    is_record_mistake: ClassVar[bool] = False
    idealises: ClassVar[str | None] = None
    is_linear: ClassVar[bool] = True

    @abstractmethod
    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Its numbers, in a session like this."""

    def starts(self, circumstances: Circumstances, place: str) -> tuple[dict[str, float], ...]:
        """Shapes to start fits from; none needed where the effect has no shapes."""
        return ({},)

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Names of the coils, sensors or movers that may have it; `room` for the room."""
        if self.kind in (Kind.ROOM, Kind.RECORD):
            return (str(self.kind),)
        bodies: dict[Kind, tuple[Body | Mover, ...]] = {
            Kind.COIL: rig.coils,
            Kind.SENSOR: rig.sensors,
            Kind.MOVER: rig.movers,
        }
        return tuple(body.name for body in bodies[self.kind])

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the session could show it; a cause that needs a temperature does not concern one without a thermometer."""
        return True

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """Keys of quantities that the session cannot show, or not beside the others: they keep their value."""
        return frozenset()

    def broken_rule(self, values: Mapping[str, float]) -> tuple[str, str] | None:
        """The first quantity whose value it cannot have, and the rule; None where all are possible."""
        for quantity in self.quantities(Extent()):
            low, high = quantity.prior.lower, quantity.prior.upper
            is_bounded = quantity.is_fixed and quantity.unit == "1"
            if is_bounded and not low <= values[quantity.key] <= high:
                return quantity.key, f"must lie between {low:g} and {high:g}"
        return None

    def is_itself(self, theta: Theta, circumstances: Circumstances) -> bool:
        """Whether what was fitted still is what the cause says, and not a small correction or the limit of something else."""
        return True

    def beyond_the_moment(self, key: str) -> str | None:
        """What of a session a quantity depends on, so that the field of a single moment cannot show it; None where that field shows it."""
        return None


class CurrentEffect(Effect):
    """Changes what the supply delivers.

    Attributes:
        couples_coils: One coil drives another; superposition is tested by it.
    """

    couples_coils: ClassVar[bool] = False

    @abstractmethod
    def apply(
        self,
        current_A: Float[Tensor, "*#batch reading coil"],
        theta: Theta,
        circumstances: Circumstances,
        coil: int,
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Delivered currents."""


class WindingEffect(Effect):
    """Changes the geometry of a winding."""

    kind = Kind.COIL

    @abstractmethod
    def apply(self, winding: Winding, theta: Theta) -> Winding:
        """The winding as it really is."""


class SourceEffect(Effect):
    """Adds a source that moves with the coil and is driven by its current."""

    kind = Kind.COIL

    @abstractmethod
    def apply(
        self, points_coil_m: Float[Tensor, "*#batch pose 3"], winding: Winding, rule: Rule, theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"]:
        """Additional field in the coil frame per unit of `drive`."""

    def drive(
        self, current_A: Float[Tensor, "*#batch reading"], theta: Theta
    ) -> Float[Tensor, "*#batch reading"]:
        """What the additional field is proportional to; the coil's current unless said otherwise."""
        return current_A


class WindingMagnetisation(Effect):
    """Magnetises a winding in some patterns, each driven by currents or always there."""

    kind = Kind.COIL

    @abstractmethod
    def rings(self, rig: Rig, coil: Coil) -> tuple[Rings, Float[Tensor, "pattern ring 2"]]:
        """Rings of the winding in its frame, and the patterns: mu0 M outwards and along the axis, in T."""

    @abstractmethod
    def drives(
        self, current_A: Float[Tensor, "*#batch reading coil"], theta: Theta
    ) -> Float[Tensor, "*#batch reading pattern"]:
        """How strongly each pattern is there, given the currents of all coils."""


class PerAmpere(ABC):
    """Field of one ampere in a coil, in the room, at any points: what bodies in the room respond to."""

    @property
    @abstractmethod
    def position_m(self) -> Float[Tensor, "*#batch #pose 3"]:
        """Where the coil is in the world frame."""

    @abstractmethod
    def at(self, points_m: Float[Tensor, "*#batch pose 3"]) -> Float[Tensor, "*#batch pose 3"]:
        """Field in the world frame at one point per distinct pose."""

    @abstractmethod
    def at_each(self, points_m: Float[Tensor, "*#batch point 3"]) -> Float[Tensor, "*batch pose point 3"]:
        """Field in the world frame at points that stand still in the room, for every distinct pose of the coil."""


class RoomEffect(Effect):
    """Adds a field that stays in the room.

    Attributes:
        is_background: There without any coil; a system of several calibrations counts it once.
    """

    kind = Kind.ROOM
    is_background: ClassVar[bool] = False

    def steady_T(
        self, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"] | None:
        """Field in the world frame that is there without current."""
        return None

    def drifting_T(
        self, theta: Theta, circumstances: Circumstances
    ) -> Float[Tensor, "*#batch reading 3"] | None:
        """Field in the world frame that comes and goes with time, everywhere the same."""
        return None

    def response(
        self, per_ampere: PerAmpere, points_m: Float[Tensor, "*#batch pose 3"], theta: Theta
    ) -> Float[Tensor, "*#batch pose 3"] | None:
        """Field in the world frame per ampere in a coil."""
        return None


class MotionEffect(Effect):
    """Changes where a mover really stands."""

    kind = Kind.MOVER

    def columns(self, circumstances: Circumstances, mover: str) -> Float[Tensor, "reading column"]:
        """What the error depends on besides the pose."""
        return torch.zeros(len(circumstances), 0, dtype=torch.float64)

    @abstractmethod
    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Real pose of the flange, or real displacement."""


class MountEffect(Effect):
    """Changes how a body sits on what carries it, in the body's own frame.

    Attributes:
        is_at_reference: It was so when the reference pose was taken, which therefore is right.
    """

    is_at_reference: ClassVar[bool]

    def columns(
        self, circumstances: Circumstances, theta: Mapping[str, float]
    ) -> Float[Tensor, "reading column"]:
        """What the error depends on besides the pose; shapes that are fixed come as plain numbers."""
        return torch.zeros(len(circumstances), 0, dtype=torch.float64)

    @abstractmethod
    def apply(self, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """nominal_from_real of the body."""


class ElementEffect(Effect):
    """Puts the elements of a three-axis sensor at different positions."""

    kind = Kind.SENSOR

    @abstractmethod
    def apply(self, theta: Theta) -> Float[Tensor, "*batch 3 3"]:
        """Position of the x, y and z element in the sensor frame."""


class ReadingEffect(Effect):
    """Changes what a sensor says, given the true field in its frame."""

    kind = Kind.SENSOR

    @abstractmethod
    def apply(
        self,
        field_sensor_T: Float[Tensor, "*#batch reading 3"],
        theta: Theta,
        circumstances: Circumstances,
        sensor: str,
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are read."""


class Prediction(ABC):
    """What a model predicts at the nominal values of its rig: scatter may grow with it."""

    @property
    @abstractmethod
    def field_sensor_T(self) -> Float[Tensor, "reading 3"]:
        """Components as they should be read."""

    @abstractmethod
    def gradient_T_per_m(self, mover: str) -> Float[Tensor, "reading 3 3"]:
        """Change of each component per displacement of a mover along its axes."""


@dataclass(frozen=True)
class NoiseEstimate:
    """What whitened residuals say of a noise effect by themselves, before anything is fitted.

    Attributes:
        quantities: Values of its quantities by key.
        noise_factor: What remains of the noise that the sensor had without it.
        log_likelihood_improvement: Over normal scatter of one width.
    """

    quantities: Mapping[str, float]
    noise_factor: float
    log_likelihood_improvement: float


class NoiseEffect(Effect):
    """Changes how readings scatter; what is predicted stays the same.

    It changes the standard deviation of components (`sigma_T`), the shape of their distribution (`contamination`), or both. Likelihood,
    simulation, predictive density and the tests of agreement all follow from these.

    Attributes:
        imitates_structure: Wrong predictions pass for it; all other causes are asked first, and again beside it.
    """

    imitates_structure: ClassVar[bool] = False

    @property
    def is_contaminating(self) -> bool:
        """Whether readings with it are not normally distributed."""
        return type(self).contamination is not NoiseEffect.contamination

    def beyond_the_moment(self, key: str) -> str | None:
        """Scatter is no property of a field."""
        return "the noise, which simulators make themselves"

    def exposure(self, prediction: Prediction, place: str) -> Float[Tensor, "reading 3"]:
        """What the standard deviation of each component depends on besides the quantities; 1 unless said otherwise."""
        return torch.ones_like(prediction.field_sensor_T)

    def sigma_T(
        self,
        sigma_T: Float[Tensor, "*#batch component"],
        exposure: Float[Tensor, " component"],
        theta: Theta,
    ) -> Float[Tensor, "*#batch component"]:
        """Standard deviation of the components that it concerns, given the one without it."""
        return sigma_T

    def contamination(self, theta: Theta) -> tuple[Float[Tensor, "*batch"], Float[Tensor, "*batch"]] | None:
        """Share of components from a wider normal distribution, and how many times wider it is; None where all scatter normally.

        References: Hogg, Bovy and Lang, arXiv:1008.4686, section 3 (mixture of good and bad readings).
        """
        return None

    def estimate(self, whitened: Float[Tensor, " component"]) -> NoiseEstimate | None:
        """Quantities that whitened residuals suggest; None where only a fit can say, or there are too few of them."""
        return None

    def disturbed_T(
        self,
        error_T: Float[Tensor, "reading 3"],
        sigma_T: Float[Tensor, "reading 3"],
        prediction: Prediction,
        theta: Theta,
        place: str,
        rng: np.random.Generator,
    ) -> Float[Tensor, "reading 3"]:
        """Errors of simulated readings, given those without it and their standard deviation: the variance that it adds, drawn normally."""
        wider_T = self.sigma_T(sigma_T.flatten(), self.exposure(prediction, place).flatten(), theta)
        added_T = torch.sqrt((wider_T.view_as(sigma_T) ** 2 - sigma_T**2).clamp(min=0.0))
        return error_T + added_T * torch.from_numpy(rng.normal(size=tuple(error_T.shape)))


class RecordEffect(Effect):
    """Changes what was written down: the currents, the readings, or both."""

    kind = Kind.RECORD
    is_record_mistake: ClassVar[bool] = True

    def commanded_A(
        self, recorded_A: Float[Tensor, "*#batch reading coil"], theta: Theta
    ) -> Float[Tensor, "*#batch reading coil"]:
        """Commanded currents behind the recorded ones."""
        return recorded_A

    def recorded_T(
        self, field_sensor_T: Float[Tensor, "*#batch reading 3"], theta: Theta
    ) -> Float[Tensor, "*#batch reading 3"]:
        """Components as they are recorded, given what the sensors said."""
        return field_sensor_T

    def recorded_error_T(
        self, error_T: Float[Tensor, "*#batch component"], theta: Theta
    ) -> Float[Tensor, "*#batch component"]:
        """Errors, or standard deviations, of recorded components, given those of what the sensors said."""
        return error_T
