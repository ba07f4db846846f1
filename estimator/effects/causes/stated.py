"""What the rig file states and is not so: where bodies and bases stand, how a winding is made, how large a noise is.

A number that the rig file leaves free, and loosely, follows what the readings say: what a cause here would change is then projected away,
and its evidence is gone by itself. Where the file fixes a number, or knows it tightly, nothing but such a cause can say that it is wrong.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from estimator.effects.base import Kind, Quantity, Theta, normal, triple
from estimator.effects.circumstances import Circumstances, Extent
from estimator.effects.stages import (
    FEWEST_COMPONENTS,
    MotionEffect,
    MountEffect,
    NoiseEffect,
    NoiseEstimate,
    Prediction,
    SidesEffect,
    WindingEffect,
)
from estimator.field.sided import SidedWinding
from estimator.field.winding import Winding
from estimator.frames import Transform, rotation_from_vector
from estimator.rig.parameters import LogNormal
from estimator.rig.rig import Body, MotionKind, Rig, SidedCoil
from estimator.tensors import Tensor, torch

SHIFT_KEYS, TURN_KEYS = ("x_m", "y_m", "z_m"), ("rx_rad", "ry_rad", "rz_rad")
LOOSE_NOISE = 0.2  # relative width of a prior from which on the noise follows the readings by itself
ASKEW_KEYS = frozenset(("rx_rad", "ry_rad"))  # as `mount_tilt` has them


def _elsewhere(shift_m: float, turn_rad: float) -> tuple[Quantity, ...]:
    """Shift and rotation vector of a body, with their standard deviations."""
    return (*triple("xyz", "_m", "m", shift_m), *triple(("rx", "ry", "rz"), "_rad", "rad", turn_rad))


def _small(theta: Theta) -> Transform:
    """The transform of six such numbers, with a pose axis of length 1."""
    shift_m, turn_rad = (
        torch.stack([theta[key] for key in keys], dim=-1) for keys in (SHIFT_KEYS, TURN_KEYS)
    )
    return Transform(rotation_from_vector(turn_rad)[..., None, :, :], shift_m[..., None, :])


class Misplaced(MountEffect):
    """A body sits elsewhere than the rig file says, or turned, in its own frame."""

    is_at_reference: ClassVar[bool] = False

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift and rotation vector in the body's own frame."""
        return _elsewhere(1e-3, math.radians(1.0))

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """A turn across the axis of a displaced body whose reference pose may turn as far: that is `mount_tilt`, to the last digit."""
        rig = circumstances.rig
        body = next(body for body in (*rig.coils, *rig.sensors) if body.name == place)
        if not is_displaced(rig, body):
            return frozenset()
        pose0 = f"{place}.world_from_{self.kind}0"
        priors = [rig.parameters[f"{pose0}.{key}"].prior for key in ("tilt_x_rad", "tilt_y_rad")]
        is_loose = all(prior is not None and prior.sd >= math.radians(1.0) for prior in priors)
        return ASKEW_KEYS if is_loose else frozenset()

    def apply(self, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """nominal_from_real of the body."""
        return _small(theta)


def is_displaced(rig: Rig, body: Body) -> bool:
    """Whether a mover carries the body and reports displacements."""
    return body.carried_by is not None and rig.mover(body.carried_by).motion is MotionKind.DISPLACEMENT


class SensorMisplaced(Misplaced):
    """The sensor sits elsewhere on its holder, or turned in it."""

    name: ClassVar[str] = "sensor_misplaced"
    kind: ClassVar[Kind] = Kind.SENSOR
    words: ClassVar[str] = "the sensor sits elsewhere on its holder, or turned in it"
    source: ClassVar[str] = "probes are glued or clamped to about 1 mm and 1 degree"


class CoilMisplaced(Misplaced):
    """The coil sits elsewhere on what carries it, or in the room, or is turned there."""

    name: ClassVar[str] = "coil_misplaced"
    kind: ClassVar[Kind] = Kind.COIL
    words: ClassVar[str] = "the coil sits elsewhere than stated, or turned there"
    source: ClassVar[str] = "coils are bolted or clamped to about 1 mm and 1 degree"

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """Nor a turn about the axis of a round coil, or one without a winding, that is not displaced: nobody could tell."""
        rig = circumstances.rig
        coil = next(coil for coil in rig.coils if coil.name == place)
        can_show = is_displaced(rig, coil) or isinstance(coil, SidedCoil)
        about_axis = frozenset() if can_show else frozenset(("rz_rad",))
        return super().unseen(circumstances, place) | about_axis


class BaseMisplaced(MotionEffect):
    """The base of an arm or a mapper stands elsewhere in the room, or turned."""

    name: ClassVar[str] = "base_misplaced"
    words: ClassVar[str] = "the base of the mover stands elsewhere in the room, or turned"
    source: ClassVar[str] = "bases are placed by tape and level to about 2 mm and 0.5 degree"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Shift and rotation vector in the frame of the base as stated."""
        return _elsewhere(2e-3, math.radians(0.5))

    def places(self, rig: Rig) -> tuple[str, ...]:
        """Movers that report where they stand; displacements begin wherever the reference pose is."""
        return tuple(mover.name for mover in rig.movers if mover.motion is not MotionKind.DISPLACEMENT)

    def apply(self, pose: Transform, columns: Float[Tensor, "pose column"], theta: Theta) -> Transform:
        """Pose in the frame of the base as stated."""
        return _small(theta) @ pose


class WindingMisstated(WindingEffect):
    """The winding has another radius, wire or number of loops than the rig file says."""

    name: ClassVar[str] = "winding_misstated"
    words: ClassVar[str] = "the winding has another radius, wire or number of loops than stated"
    source: ClassVar[str] = (
        "radii by calliper over the insulation, 2 %; enamelled wire, 2 %; loops counted from outside, 3 %"
    )
    can_begin: ClassVar[bool] = False
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of the external radius, of the wire's thickness and of both numbers of loops."""
        widths = {"radius": 0.02, "wire": 0.02, "axial_loops": 0.03, "radial_loops": 0.03}
        return tuple(normal(key, "1", sd) for key, sd in widths.items())

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """The wire where the rig file leaves a pitch open: its own prior bounds what can be built, as for `axial_pitch`."""
        pitches = (circumstances.rig.parameters[f"{place}.{key}_pitch_m"] for key in ("axial", "radial"))
        return frozenset(("wire",)) if any(pitch.is_free for pitch in pitches) else frozenset()

    def apply(self, winding: Winding, theta: Theta) -> Winding:
        """The winding as it really is."""
        radius, wire, axial, radial = (
            1.0 + theta[key] for key in ("radius", "wire", "axial_loops", "radial_loops")
        )
        numbers = (
            winding.radius_m * radius,
            winding.axial_loops * axial,
            winding.radial_loops * radial,
            winding.axial_pitch_m * wire,
            winding.radial_pitch_m * wire,
        )
        return Winding(*torch.broadcast_tensors(*numbers))


class SidesMisstated(SidesEffect):
    """The winding with straight sides has other sides, corners, wire or number of loops than the rig file says."""

    name: ClassVar[str] = "sides_misstated"
    words: ClassVar[str] = "the winding has other sides, corners, wire or number of loops than stated"
    source: ClassVar[str] = (
        "formers by calliper under a wire that bulges, 2 %; corners by radius gauge, 10 %; enamelled wire, 2 %; loops from outside, 3 %"
    )
    is_structural: ClassVar[bool] = True

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Relative excess of both sides of the bore, of its corner radius, of the wire's thickness and of both numbers of loops."""
        widths = {"side_x": 0.02, "side_y": 0.02, "corner": 0.1, "wire": 0.02}
        counts = {"axial_loops": 0.03, "radial_loops": 0.03}
        return tuple(normal(key, "1", sd) for key, sd in (widths | counts).items())

    def unseen(self, circumstances: Circumstances, place: str) -> frozenset[str]:
        """The corner of a winding with sharp ones; the wire where the rig file leaves a pitch open, as for `winding_misstated`."""
        parameters = circumstances.rig.parameters
        is_open = any(parameters[f"{place}.{key}_pitch_m"].is_free for key in ("axial", "radial"))
        has_corner = f"{place}.inner_corner_radius_m" in parameters
        return frozenset((*(() if has_corner else ("corner",)), *(("wire",) if is_open else ())))

    def apply(self, winding: SidedWinding, theta: Theta) -> SidedWinding:
        """The winding as it really is."""
        keys = ("side_x", "side_y", "corner", "axial_loops", "radial_loops", "wire", "wire")
        numbers = (number * (1.0 + theta[key]) for number, key in zip(winding.numbers, keys, strict=True))
        return SidedWinding(winding.is_rounded, *torch.broadcast_tensors(*numbers))


class NoiseMisstated(NoiseEffect):
    """A sensor's readings scatter by a multiple of what the rig file says."""

    name: ClassVar[str] = "noise_misstated"
    kind: ClassVar[Kind] = Kind.SENSOR
    words: ClassVar[str] = "the readings scatter more, or less, than the noise that is stated"
    source: ClassVar[str] = "data sheets give the noise of another bandwidth: a factor of two either way"

    def quantities(self, extent: Extent) -> tuple[Quantity, ...]:
        """Noise over what is stated."""
        return (Quantity("factor", "1", LogNormal(1.0, 0.7), 1.0),)

    def concerns(self, circumstances: Circumstances, place: str) -> bool:
        """Whether the noise is fixed, or known tightly."""
        prior = circumstances.rig.parameters[f"{place}.noise_T"].prior
        return prior is None or prior.sd < LOOSE_NOISE * prior.centre

    def sigma_T(
        self,
        sigma_T: Float[Tensor, "*#batch component"],
        exposure: Float[Tensor, " component"],
        theta: Theta,
    ) -> Float[Tensor, "*#batch component"]:
        """The multiple of the noise."""
        return sigma_T * theta["factor"][..., None]

    def estimate(self, whitened: Float[Tensor, " component"]) -> NoiseEstimate | None:
        """Noise over the stated one, by the rms of the whitened residual."""
        if len(whitened) <= FEWEST_COMPONENTS:
            return None
        mean_square = float(whitened.square().mean())
        gain = 0.5 * len(whitened) * (mean_square - 1.0 - math.log(mean_square))
        return NoiseEstimate({"factor": math.sqrt(mean_square)}, 1.0, gain)

    def disturbed_T(
        self,
        error_T: Float[Tensor, "reading 3"],
        sigma_T: Float[Tensor, "reading 3"],
        prediction: Prediction,
        theta: Theta,
        place: str,
        rng: np.random.Generator,
    ) -> Float[Tensor, "reading 3"]:
        """Errors grow by the factor."""
        return error_T * theta["factor"]
