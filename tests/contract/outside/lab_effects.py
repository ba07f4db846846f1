"""Causes that coilcal does not know: a package of a laboratory, outside the repository, with one effect per stage.

Most are a declaration and a function; some are classes, as what needs several functions may be.

Tests copy it to a folder of its own, where its entry points make it known (`entry_points.txt` beside this file).
"""

from __future__ import annotations

import torch

from estimator.effects.base import Kind, Quantity, normal, switch
from estimator.effects.stages import (
    ElementEffect,
    HolderEffect,
    MotionEffect,
    MountEffect,
    NoiseEffect,
    OneCoilCurrent,
    ReadingEffect,
    RecordEffect,
    RoomEffect,
    SourceEffect,
    WindingEffect,
)
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.rig.parameters import LogNormal


# Quantities: missing current.
@OneCoilCurrent.cause(quantities=(normal("width_A", "A", 0.05),))
def dead_band(current_A, theta):
    """The supply leaves out a fixed current around zero.

    Source: class B output stages without bias, 10 to 100 mA.
    """
    return current_A - theta["width_A"][..., None] * torch.sign(current_A)


class SwollenWire(WindingEffect):
    """The insulation has swollen: both pitches grow alike."""

    name = "swollen_wire"
    words = "swollen insulation spreads the winding both ways"
    source = "lacquer in solvent, up to 10 %"

    def quantities(self, extent):
        """Relative excess of both pitches."""
        return (normal("excess", "1", 0.05),)

    def apply(self, winding, theta):
        """Wider spaced loops."""
        factor = 1.0 + theta["excess"]
        numbers = torch.broadcast_tensors(
            winding.radius_m,
            winding.axial_loops,
            winding.radial_loops,
            winding.axial_pitch_m * factor,
            winding.radial_pitch_m * factor,
        )
        return Winding(*numbers)


class IronBeside(SourceEffect):
    """A bolt beside the coil is magnetised by it and moves with it."""

    name = "iron_beside"
    words = "iron beside the coil is magnetised by it"
    source = "steel bolts of a holder, up to a tenth of the coil's moment"

    def quantities(self, extent):
        """Moment in units of the winding's."""
        return (normal("share", "1", 0.1),)

    def apply(self, points_coil_m, winding, rule, theta):
        """Field of a dipole two radii off the axis, in the plane of the front face."""
        moment = theta["share"] * winding.moment_m2
        x, y, z = points_coil_m.unbind(-1)
        x = x - 2.0 * winding.radius_m[..., None]
        r2 = x**2 + y**2 + z**2
        common = 1e-7 * moment[..., None] * r2**-2.5
        parts = (3.0 * x * z * common, 3.0 * y * z * common, (3.0 * z**2 - r2) * common)
        return torch.stack(torch.broadcast_tensors(*parts), dim=-1)


@RoomEffect.cause("steady_T", quantities=(normal("vertical_T_per_m", "T/m", 5e-4),))
def field_gradient(points_m, theta):
    """The field of the room has a gradient.

    A magnet far away adds a gradient to the field of the room, free of sources: (-x/2, -y/2, z).

    Source: a magnet some metres away, up to 1 mT/m.
    """
    shape = torch.tensor([-0.5, -0.5, 1.0], dtype=points_m.dtype)
    return theta["vertical_T_per_m"][..., None, None] * shape * points_m


# Quantities: sag at a metre, which grows with the square of the reach.
@MotionEffect.cause(quantities=(normal("curvature_per_m", "1/m", 0.05),))
def arm_sag(pose, theta):
    """The arm sags the further it reaches.

    The arm sags the further it reaches: lower by the square of the horizontal reach.

    Source: bending of light arms, 0.1 mm at 0.1 m and more.
    """
    x, y, z = pose.translation_m.unbind(-1)
    sag_m = theta["curvature_per_m"][..., None] * (x**2 + y**2)
    return Transform(pose.rotation, torch.stack(torch.broadcast_tensors(x, y, z - sag_m), dim=-1))


class HolderCreep(MountEffect):
    """The holder of the sensor gives way steadily."""

    name, kind, is_at_reference = "holder_creep", Kind.SENSOR, False
    words = "the sensor's holder gives way steadily"
    source = "printed holders creep by 0.1 mm and more a day"

    def quantities(self, extent):
        """Along the sensor's z axis."""
        return (normal("rate_m_per_h", "m/h", 1e-3 / extent.duration_h),)

    def columns(self, circumstances, theta):
        """Hours since the session began."""
        return circumstances.hours[:, None]

    def apply(self, columns, theta):
        """nominal_from_real."""
        along_m = theta["rate_m_per_h"][..., None] * columns[:, 0]
        zero = torch.zeros_like(along_m)
        eye = torch.eye(3, dtype=columns.dtype)[None]
        return Transform(eye, torch.stack((zero, zero, along_m), dim=-1))


def ahead_m(theta):
    """Two and a half centimetres ahead."""
    ahead = torch.tensor([0.0, 0.0, 0.025], dtype=torch.float64)
    return torch.ones_like(theta["share"])[..., None] * ahead


@HolderEffect.cause(
    "answer_T",
    quantities=(normal("share", "1", 0.05),),  # of the axial field at the bead
    place_m=ahead_m,
)
def ferrite_bead(field_there_T, theta):
    """A ferrite bead sits on the sensor's holder.

    A bead on the holder, ahead of the sensor, adds to the field along the sensor's axis.

    Source: some per cent at a centimetre or two.
    """
    axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    return theta["share"][..., None, None] * field_there_T * axis


@ElementEffect.cause(quantities=(normal("radius_m", "m", 5e-4),))
def element_ring(theta):
    """The elements sit on a ring.

    The elements sit on a ring about the sensor's axis, a third of a turn apart.

    Source: dies on a printed board, 0.1 to 1 mm apart.
    """
    angle = 2.0 * torch.pi / 3.0 * torch.arange(3, dtype=torch.float64)
    ring = torch.stack((torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)), dim=-1)
    return theta["radius_m"][..., None, None] * ring


@ReadingEffect.cause(
    quantities=lambda extent: (normal("excess_per_T", "1/T", 0.02 / extent.largest_field_T),)
)
def quadratic_response(field_sensor_T, theta):
    """Both signs of a large field read too much.

    The amplifier bends: both signs of the field read too much.

    Source: amplifiers of this kind, 2 % at the end of the range.
    """
    return field_sensor_T + theta["excess_per_T"][..., None, None] * field_sensor_T**2


class NoisyAxis(NoiseEffect):
    """The sensor's z axis scatters more than the others."""

    name, kind = "noisy_axis", Kind.SENSOR
    words = "the sensor's z axis scatters more than the others"
    source = "one of three elements is worse, by some times the noise"

    def quantities(self, extent):
        """Standard deviation beside the noise."""
        return (Quantity("extra_T", "T", LogNormal(3e-5, 1.0), 0.0),)

    def exposure(self, prediction, place):
        """1 along z, 0 along x and y."""
        along_z = torch.tensor([0.0, 0.0, 1.0], dtype=prediction.field_sensor_T.dtype)
        return along_z.expand_as(prediction.field_sensor_T)

    def sigma_T(self, sigma_T, exposure, theta):
        """Both parts are independent."""
        return torch.sqrt(sigma_T**2 + (theta["extra_T"][..., None] * exposure) ** 2)


@RecordEffect.cause(
    "commanded_A",
    quantities=(switch("factor", 0.1, 10.0, 1.0),),  # recorded over real current
    starts=({"factor": 2.0},),  # twice the amplitude
)
def peak_to_peak_current(recorded_A, theta):
    """Currents are recorded from peak to peak.

    Source: there or not.
    """
    return recorded_A / theta["factor"][..., None, None]
