"""The stages at which an effect acts, one abstract class each: what an effect of that stage declares beside its quantities.

From the supply to the record: current, winding, source, magnetisation of a winding, room, mover, mount, elements of a sensor, reading,
noise and record. `effects.base` has what is common to all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from estimator.effects.base import Effect, Kind, Theta
from estimator.effects.circumstances import Circumstances
from estimator.field.core import Core
from estimator.field.magnetised import Rings
from estimator.field.node_sum import Nodes, SumMode
from estimator.field.sided import SidedWinding
from estimator.field.winding import Winding, field_of_loops
from estimator.field.winding_shape import Rule
from estimator.frames import Transform
from estimator.rig.bodies import Coil, SidedCoil
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

Currents = Float[Tensor, "*#batch reading coil"]  # A, of all coils
Current = Float[Tensor, "*#batch reading"]  # A, of one coil
Points = Float[Tensor, "*#batch pose 3"]  # m
Field = Float[Tensor, "*#batch pose 3"]  # T or T/A, at points
Components = Float[Tensor, "*#batch reading 3"]  # T, along the axes of a sensor or of the room
Columns = Float[Tensor, "*#batch row column"]  # what an error of a pose depends on, by reading or pose
Deviations = Float[Tensor, "*#batch component"]  # T, errors or standard deviations
Vector = Float[Tensor, "*batch 3"]
Errors = Float[Tensor, "reading 3"]  # T, of all components of all readings

FEWEST_COMPONENTS = 10  # from which on a sensor's residuals say anything of its scatter


class CurrentEffect(Effect):
    """Changes what the supply delivers.

    Attributes:
        couples_coils: One coil drives another; superposition is tested by it.
        exchanges_coils: A coil may carry current where the record says that it has none.
    """

    kind = Kind.COIL
    changes_field = True
    couples_coils: ClassVar[bool] = False
    exchanges_coils: ClassVar[bool] = False

    @abstractmethod
    def apply(self, current_A: Currents, theta: Theta, circumstances: Circumstances, coil: int) -> Currents:
        """Delivered currents."""


class OneCoilCurrent(CurrentEffect):
    """Changes the current of one coil and leaves the others."""

    @abstractmethod
    def delivered(self, current_A: Current, theta: Theta, circumstances: Circumstances, coil: int) -> Current:
        """Current in the coil."""

    def apply(self, current_A: Currents, theta: Theta, circumstances: Circumstances, coil: int) -> Currents:
        """Delivered currents."""
        delivered_A = self.delivered(current_A[..., coil], theta, circumstances, coil)
        current_A = current_A.expand(*delivered_A.shape, current_A.shape[-1])
        is_coil = torch.arange(current_A.shape[-1], device=current_A.device) == coil
        return torch.where(is_coil, delivered_A[..., None], current_A)


class WindingEffect(Effect):
    """Changes the geometry of a winding."""

    kind = Kind.COIL
    changes_field = True
    needs_winding: ClassVar[bool] = True

    @abstractmethod
    def apply(self, winding: Winding, theta: Theta) -> Winding:
        """The winding as it really is."""


class SidesEffect(Effect):
    """Changes the geometry of a winding with straight sides."""

    kind = Kind.COIL
    changes_field = True

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Coils with straight sides."""
        return tuple(coil.name for coil in rig.wound if isinstance(coil, SidedCoil))

    @abstractmethod
    def apply(self, winding: SidedWinding, theta: Theta) -> SidedWinding:
        """The winding as it really is."""


class SourceEffect(Effect):
    """Adds a source that moves with the coil and is driven by its current, or is always there.

    Attributes:
        is_permanent: There without current too.
    """

    kind = Kind.COIL
    changes_field = True
    needs_winding: ClassVar[bool] = True
    is_permanent: ClassVar[bool] = False

    @abstractmethod
    def apply(self, points_coil_m: Points, winding: Winding, rule: Rule, theta: Theta) -> Field:
        """Additional field in the coil frame per unit of `drive`."""

    def drive(self, current_A: Current, theta: Theta) -> Current:
        """What the additional field is proportional to: the coil's current, or 1 where it is permanent, unless said otherwise."""
        return torch.ones_like(current_A) if self.is_permanent else current_A


class AddedLoops(SourceEffect):
    """Adds loops about the axis of the coil, which its current runs through."""

    @abstractmethod
    def loops(self, winding: Winding, rule: Rule, theta: Theta) -> tuple[Nodes, int]:
        """The loops in the coil frame, on a grid of two node axes, and the AGM steps of each."""

    def apply(
        self, points_coil_m: Points, winding: Winding, rule: Rule, theta: Theta, mode: SumMode = SumMode.PLAIN
    ) -> Field:
        """Field of the loops per ampere.

        Args:
            points_coil_m, winding, rule, theta: As with other sources.
            mode: How loops are summed.
        """
        loops, steps = self.loops(winding, rule, theta)
        return field_of_loops(points_coil_m, loops, steps, mode)


class WindingMagnetisation(Effect):
    """Magnetises a winding in some patterns, each driven by currents or always there."""

    kind = Kind.COIL
    changes_field = True
    needs_winding: ClassVar[bool] = True

    @abstractmethod
    def rings(self, rig: Rig, coil: Coil) -> tuple[Rings, Float[Tensor, "pattern ring 2"]]:
        """Rings of the winding in its frame, and the patterns: mu0 M outwards and along the axis, in T."""

    @abstractmethod
    def drives(self, current_A: Currents, theta: Theta) -> Float[Tensor, "*#batch reading pattern"]:
        """How strongly each pattern is there, given the currents of all coils."""


class CoreMagnetisation(Effect):
    """Puts a body of iron into the bore of a coil, which answers all coils and the other bodies (`model.cores`)."""

    kind = Kind.COIL
    changes_field = True
    needs_winding: ClassVar[bool] = True
    is_linear: ClassVar[bool] = False

    @abstractmethod
    def core(self, theta: Theta) -> Core:
        """Shape and iron of the core."""


class CoreMemory(Effect):
    """Makes such a body lag behind the current of its coil."""

    kind = Kind.COIL
    needs_winding: ClassVar[bool] = True
    is_linear: ClassVar[bool] = False

    @abstractmethod
    def lag_A(self, theta: Theta, circumstances: Circumstances, coil: int) -> Current:
        """What the body takes the coil's current for, less that current."""


class PerAmpere(ABC):
    """Field of one ampere in a coil, in the room, at any points: what bodies in the room respond to."""

    @property
    @abstractmethod
    def position_m(self) -> Float[Tensor, "*#batch #pose 3"]:
        """Position of the coil in the world frame, in m."""

    @abstractmethod
    def at(self, points_m: Points) -> Field:
        """Field in the world frame at one point per distinct pose."""

    @abstractmethod
    def at_each(self, points_m: Float[Tensor, "*#batch point 3"]) -> Float[Tensor, "*batch pose point 3"]:
        """Field in the world frame at points that stand still in the room, for every distinct pose of the coil."""


class RoomEffect(Effect):
    """Adds a field that stays in the room; of kind `coil`, one that answers that coil alone.

    Attributes:
        is_background: There without any coil; a system of several calibrations counts it once.
    """

    kind = Kind.ROOM
    changes_field = True
    is_background: ClassVar[bool] = False

    def steady_T(self, points_m: Points, theta: Theta) -> Field | None:
        """Field in the world frame that is there without current."""
        return None

    def drifting_T(self, theta: Theta, circumstances: Circumstances) -> Components | None:
        """Field in the world frame that comes and goes with time, everywhere the same."""
        return None

    def response(self, per_ampere: PerAmpere, points_m: Points, theta: Theta) -> Field | None:
        """Field in the world frame per ampere in a coil."""
        return None


class MotionEffect(Effect):
    """Changes where a mover really stands."""

    kind = Kind.MOVER

    def columns(self, circumstances: Circumstances, mover: str) -> Columns:
        """What the error depends on besides the pose."""
        return circumstances.current_A.new_zeros(len(circumstances), 0)

    @abstractmethod
    def apply(self, pose: Transform, columns: Columns, theta: Theta) -> Transform:
        """Real pose of the flange, or real displacement."""


class MountEffect(Effect):
    """Changes how a body sits on what carries it, in the body's own frame.

    Attributes:
        is_at_reference: It was so when the reference pose was taken, which therefore is right.
        is_step: From an instant on the body sits elsewhere, and before it where it should; the instant is its only shape.
        goes_with_current: It depends on the currents of the moment, so that a prediction asks for its columns at each.
    """

    is_at_reference: ClassVar[bool] = False
    is_step: ClassVar[bool] = False
    goes_with_current: ClassVar[bool] = False

    def columns(self, circumstances: Circumstances, theta: Mapping[str, float]) -> Columns:
        """What the error depends on besides the pose; shapes that are fixed come as plain numbers."""
        return circumstances.current_A.new_zeros(len(circumstances), 0)

    def columns_of(self, circumstances: Circumstances, theta: Mapping[str, float], body: str) -> Columns:
        """Columns of one body; those of `columns` unless it matters which body it is."""
        return self.columns(circumstances, theta)

    @abstractmethod
    def apply(self, columns: Columns, theta: Theta) -> Transform:
        """nominal_from_real of the body."""


class ElementEffect(Effect):
    """Puts the elements of a three-axis sensor at different positions."""

    kind = Kind.SENSOR

    @abstractmethod
    def apply(self, theta: Theta) -> Float[Tensor, "*batch 3 3"]:
        """Position of the x, y and z element in the sensor frame."""


class HolderEffect(Effect):
    """Adds to the field at a sensor what something beside it, which moves with it, makes of the field where that is."""

    kind = Kind.SENSOR

    @abstractmethod
    def place_m(self, theta: Theta) -> Vector:
        """Its place in the sensor frame."""

    @abstractmethod
    def answer_T(self, field_there_T: Components, theta: Theta) -> Components:
        """Field that it adds at the sensor, in the sensor frame.

        Args:
            field_there_T: Field where it is, without it, in the sensor frame.
            theta: Its quantities.
        """


class ReadingEffect(Effect):
    """Changes what a sensor says, given the true field in its frame."""

    kind = Kind.SENSOR

    @abstractmethod
    def apply(
        self, field_sensor_T: Components, theta: Theta, circumstances: Circumstances, sensor: str
    ) -> Components:
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
    """

    kind = Kind.SENSOR
    depends_on: ClassVar[str | None] = "the noise, which simulators make themselves"

    @property
    def is_contaminating(self) -> bool:
        """Whether readings with it are not normally distributed."""
        return type(self).contamination is not NoiseEffect.contamination

    def exposure(self, prediction: Prediction, place: str) -> Float[Tensor, "reading 3"]:
        """What the standard deviation of each component depends on besides the quantities; 1 unless said otherwise."""
        return torch.ones_like(prediction.field_sensor_T)

    def sigma_T(self, sigma_T: Deviations, exposure: Float[Tensor, " component"], theta: Theta) -> Deviations:
        """Standard deviation of the components that it concerns, given the one without it."""
        return sigma_T

    def directions_T(
        self, prediction: Prediction, theta: Theta, place: str
    ) -> Float[Tensor, "reading 3 direction"] | None:
        """Independent standard normal errors and how each moves the components of a reading together; None where all move alone."""
        return None

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
        error_T: Errors,
        sigma_T: Errors,
        prediction: Prediction,
        theta: Theta,
        place: str,
        rng: np.random.Generator,
    ) -> Errors:
        """Errors of simulated readings, given those without it and their standard deviation: the variance that it adds, drawn normally."""
        wider_T = self.sigma_T(sigma_T.flatten(), self.exposure(prediction, place).flatten(), theta)
        added_T = torch.sqrt((wider_T.view_as(sigma_T) ** 2 - sigma_T**2).clamp(min=0.0))
        return error_T + added_T * torch.from_numpy(rng.normal(size=tuple(error_T.shape))).to(error_T)


class RecordEffect(Effect):
    """Changes what was written down: the currents, the readings, or which body they belong to.

    Attributes:
        exchanges_coils: A coil may carry current where the record says that it has none.
    """

    kind = Kind.RECORD
    is_record_mistake: ClassVar[bool] = True
    exchanges_coils: ClassVar[bool] = False

    def commanded_A(self, recorded_A: Currents, theta: Theta) -> Currents:
        """Commanded currents behind the recorded ones."""
        return recorded_A

    def rows_late(self, values: Mapping[str, float]) -> int:
        """Rows by which fields were written down later than the poses and currents that they belong to."""
        return 0

    def late_since_h(self, values: Mapping[str, float]) -> float:
        """Time since the session began from which on they were."""
        return 0.0

    def place_of(self, sensor: Int[Tensor, "*#batch row"], theta: Theta) -> Int[Tensor, "*#batch row"]:
        """Index of the sensor at whose place each reading was taken, given that of the sensor in the record."""
        return sensor

    def recorded_T(self, field_sensor_T: Components, theta: Theta) -> Components:
        """Components as they are recorded, given what the sensors said."""
        return field_sensor_T

    def recorded_error_T(self, error_T: Deviations, theta: Theta) -> Deviations:
        """Errors, or standard deviations, of recorded components, given those of what the sensors said."""
        return error_T
