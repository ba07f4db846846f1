"""Causes that coilcal does not know: a package of a laboratory, outside the repository, with one effect per stage.

Tests copy it to a folder of its own, where its entry points make it known (`entry_points.txt` beside this file).
"""

from __future__ import annotations

import torch

from estimator.effects.base import Kind, Quantity, normal
from estimator.effects.stages import (
    CurrentEffect,
    ElementEffect,
    HolderEffect,
    MotionEffect,
    MountEffect,
    NoiseEffect,
    ReadingEffect,
    RecordEffect,
    RoomEffect,
    SourceEffect,
    WindingEffect,
)
from estimator.field.winding import Winding
from estimator.frames import Transform
from estimator.rig.parameters import LogNormal, Uniform


class DeadBand(CurrentEffect):
    """The supply leaves out a fixed current around zero."""

    name, kind = "dead_band", Kind.COIL
    words = "the supply leaves out a fixed current around zero"
    source = "class B output stages without bias, 10 to 100 mA"

    def quantities(self, extent):
        """Missing current."""
        return (normal("width_A", "A", 0.05),)

    def apply(self, current_A, theta, circumstances, coil):
        """Less by the width, whichever its sign."""
        missing_A = theta["width_A"][..., None] * torch.sign(current_A[..., coil])
        is_own = (torch.arange(current_A.shape[-1]) == coil).to(current_A.dtype)
        return current_A - missing_A[..., None] * is_own


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


class FieldGradient(RoomEffect):
    """A magnet far away adds a gradient to the field of the room."""

    name = "field_gradient"
    words = "the field of the room has a gradient"
    source = "a magnet some metres away, up to 1 mT/m"

    def quantities(self, extent):
        """Gradient of the vertical component."""
        return (normal("vertical_T_per_m", "T/m", 5e-4),)

    def steady_T(self, points_m, theta):
        """Free of sources: (-x/2, -y/2, z)."""
        shape = torch.tensor([-0.5, -0.5, 1.0], dtype=points_m.dtype)
        return theta["vertical_T_per_m"][..., None, None] * shape * points_m


class ArmSag(MotionEffect):
    """The arm sags the further it reaches."""

    name = "arm_sag"
    words = "the arm sags the further it reaches"
    source = "bending of light arms, 0.1 mm at 0.1 m and more"

    def quantities(self, extent):
        """Sag at a metre, which grows with the square of the reach."""
        return (normal("curvature_per_m", "1/m", 0.05),)

    def apply(self, pose, columns, theta):
        """Lower by the square of the horizontal reach."""
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


class FerriteBead(HolderEffect):
    """A bead on the holder, ahead of the sensor, adds to the field along the sensor's axis."""

    name = "ferrite_bead"
    words = "a ferrite bead sits on the sensor's holder"
    source = "some per cent at a centimetre or two"

    def quantities(self, extent):
        """Share of the axial field at the bead."""
        return (normal("share", "1", 0.05),)

    def place_m(self, theta):
        """Two and a half centimetres ahead."""
        ahead = torch.tensor([0.0, 0.0, 0.025], dtype=torch.float64)
        return torch.ones_like(theta["share"])[..., None] * ahead

    def answer_T(self, field_there_T, theta):
        """Along the axis."""
        axis = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        return theta["share"][..., None, None] * field_there_T * axis


class ElementRing(ElementEffect):
    """The elements sit on a ring about the sensor's axis."""

    name = "element_ring"
    words = "the elements sit on a ring"
    source = "dies on a printed board, 0.1 to 1 mm apart"

    def quantities(self, extent):
        """Radius of the ring."""
        return (normal("radius_m", "m", 5e-4),)

    def apply(self, theta):
        """A third of a turn apart."""
        angle = 2.0 * torch.pi / 3.0 * torch.arange(3, dtype=torch.float64)
        ring = torch.stack((torch.cos(angle), torch.sin(angle), torch.zeros_like(angle)), dim=-1)
        return theta["radius_m"][..., None, None] * ring


class QuadraticResponse(ReadingEffect):
    """The amplifier bends: both signs of the field read too much."""

    name = "quadratic_response"
    words = "both signs of a large field read too much"
    source = "amplifiers of this kind, 2 % at the end of the range"

    def quantities(self, extent):
        """Relative excess per tesla."""
        return (normal("excess_per_T", "1/T", 0.02 / extent.largest_field_T),)

    def apply(self, field_sensor_T, theta, circumstances, sensor):
        """Components as they are read."""
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


class PeakToPeakCurrent(RecordEffect):
    """Currents are recorded from peak to peak."""

    name = "peak_to_peak_current"
    words = "currents are recorded from peak to peak"
    source = "there or not"

    def quantities(self, extent):
        """Recorded over real current."""
        return (Quantity("factor", "1", Uniform(0.1, 10.0), 1.0, is_shape=True, is_fixed=True),)

    def starts(self, circumstances, place):
        """Twice the amplitude."""
        return ({"factor": 2.0},)

    def commanded_A(self, recorded_A, theta):
        """Amplitudes."""
        return recorded_A / theta["factor"][..., None, None]
