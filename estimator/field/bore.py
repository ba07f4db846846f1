"""Static magnetic fields without sources in a long cylinder: waves along its axis that grow as modified Bessel functions across it.

Sources lie outside the cylinder, at any distance, so what ends of windings, steel beside a bore or joints between coils add there is
followed where a ball about all places would hold the sources. Each field is free of divergence and curl. Coordinates are in units of the
radius. Every wave has rms 1 at twice the radius: with equal widths there, amplitudes fall at the places as those of sources beside them do.
With equal widths at the places, or fewer turns, intervals for sources beside a bore were too narrow (docs/decisions/0019).
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from jaxtyping import Float

from estimator.field.harmonics import interior_field
from estimator.field.machine_code import has_derivatives
from estimator.tensors import Tensor, torch

SOURCES = 2.0  # radii from the axis, where sources are expected to begin
MOST_TURNS = 6  # around the axis: fields with m turns fall as the power m - 1 of the distance from the wall
WAVES = ("cos0", *(f"{wave}{m}" for m in range(1, MOST_TURNS + 1) for wave in ("cos", "sin")))
N_TERMS = 28  # of a power series: fourteen digits up to an argument of 16, twice the wall's of the steepest wave that is asked


def bore_field(
    points: Float[Tensor, "*#batch point 3"],
    length: float | Float[Tensor, ""],
    trend: Float[Tensor, "*#batch trend"] | None,
    waves: Mapping[int, Float[Tensor, "*#batch wave"]],
) -> Float[Tensor, "*batch point 3"]:
    """Field of sources outside a cylinder about z.

    Args:
        points: About the middle of the cylinder, in its radius.
        length: Of the cylinder, in its radius. Half waves fit into it, and repeat beyond as in a mirror.
        trend: Amplitudes of a uniform field and of the five slopes of one, of rms 1 at half the length from the middle.
        waves: By the number n >= 1 of half waves the amplitudes of `WAVES`, of m turns around the axis.
    References: Jackson, Classical Electrodynamics, 3rd ed., section 3.11 (cylindrical harmonics).
    Examples:
        >>> along_z = torch.eye(8, dtype=torch.float64)[0]
        >>> bore_field(torch.zeros(1, 3, dtype=torch.float64), 10.0, along_z, {})
        tensor([[0., 0., 1.]], dtype=torch.float64)
    """
    total = torch.zeros_like(points)
    if trend is not None:
        uniform, slopes = trend.split((3, 5), dim=-1)
        total = total + interior_field(points / (0.5 * length), {1: uniform, 2: slopes})
    if not waves:
        return total
    amplitude = torch.stack([waves[n] for n in waves], dim=-2)  # half waves, wave
    wavenumber = math.pi / length * points.new_tensor(list(waves))
    amplitude = amplitude / _rms_at_sources(wavenumber)
    if not _share_points(amplitude, points):
        return total + _sum_of_waves(points, length, wavenumber, amplitude)
    each = _each_wave(points.reshape(-1, 3), length, wavenumber)
    rows = amplitude.reshape(-1, len(each)) @ each.flatten(1)
    return total + rows.reshape(*amplitude.shape[: -points.dim()], *points.shape)


def _share_points(amplitude: Tensor, points: Tensor) -> bool:
    """Whether many amplitudes meet the same points, so that waves there are computed once; their graphs would be larger."""
    n_alike = points.dim() - 2
    rows, alike = amplitude.shape[: -2 - n_alike], amplitude.shape[-2 - n_alike : -2]
    return (
        rows.numel() > 1
        and alike.numel() == 1
        and not (has_derivatives(points) or has_derivatives(amplitude))
    )


def _sum_of_waves(points: Tensor, length: float | Tensor, wavenumber: Tensor, amplitude: Tensor) -> Tensor:
    x, y, along, rising, bessel = _factors(points, length, wavenumber)
    none = torch.zeros_like(x)
    # Of all turns: slopes of the angular factors, the factors times I'(x) / x, and times I(x).
    slope_x, slope_y, outwards, upwards = none, none, none, none
    real, imaginary = torch.ones_like(x), none  # (x + i y)^m
    below = (none, none)
    for m in range(MOST_TURNS + 1):
        c = amplitude[..., 2 * m - 1 if m else 0, None]
        angular = c * real
        if m:
            d = amplitude[..., 2 * m, None]
            angular = torch.addcmul(angular, d, imaginary)
            steep = m * bessel[m]
            slope_x = torch.addcmul(slope_x, torch.addcmul(c * below[0], d, below[1]), steep)
            slope_y = torch.addcmul(slope_y, torch.addcmul(d * below[0], c, below[1], value=-1.0), steep)
        # The derivative of the reduced Bessel function in s is half the next one.
        outwards = torch.addcmul(outwards, angular, bessel[m + 1])
        upwards = torch.addcmul(upwards, angular, bessel[m])
        below = (real, imaginary)
        real, imaginary = (
            torch.addcmul(x * real, y, imaginary, value=-1.0),
            torch.addcmul(x * imaginary, y, real),
        )
    fields = (along * (slope_x + x * outwards), along * (slope_y + y * outwards), rising * upwards)
    return torch.stack([field.sum(-2) for field in fields], dim=-1)


def _each_wave(
    points: Float[Tensor, "point 3"], length: float | Tensor, wavenumber: Tensor
) -> Float[Tensor, "each point 3"]:
    """Fields of all waves, each of amplitude one."""
    x, y, along, rising, bessel = _factors(points, length, wavenumber)
    fields = []
    none = torch.zeros_like(x)
    real, imaginary, below = torch.ones_like(x), none, (none, none)
    for m in range(MOST_TURNS + 1):
        steep = m * bessel[m]
        cosine = (real, steep * below[0], -steep * below[1])
        sine = (imaginary, steep * below[1], steep * below[0])
        for angular, slope_x, slope_y in (cosine, sine) if m else (cosine,):
            outwards = angular * bessel[m + 1]
            across = (along * (slope_x + x * outwards), along * (slope_y + y * outwards))
            fields.append(torch.stack((*across, rising * angular * bessel[m]), dim=-1))
        below = (real, imaginary)
        real, imaginary = x * real - y * imaginary, x * imaginary + y * real
    return torch.stack(fields, dim=1).flatten(0, 1)


def _factors(
    points: Tensor, length: float | Tensor, wavenumber: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, list[Tensor]]:
    """Factors of every half wave: x and y times its wavenumber, sine and cosine along the bore, and reduced Bessel functions.

    Points come last: numbers of a wave are then alike along a whole row, which takes half the time.
    """
    x, y, z = (points[..., None, :, i] * wavenumber[:, None] for i in range(3))
    phase = z + 0.5 * length * wavenumber[:, None]
    return x, y, torch.sin(phase), torch.cos(phase), _reduced_bessel(x.square() + y.square())


def _reduced_bessel(s: Float[Tensor, "*shape"]) -> list[Float[Tensor, "*shape"]]:
    """I_m(x) / x^m as functions of s = x^2, for m up to one more than `MOST_TURNS`; smooth on the axis.

    Two by their power series, whose terms are all positive, the others by downward recurrence.
    """
    highest = MOST_TURNS + 1
    values = {m: _series(s, m) for m in (highest, highest - 1)}
    for m in range(highest - 1, 0, -1):
        values[m - 1] = 2.0 * m * values[m] + s * values[m + 1]
    return [values[m] for m in range(highest + 1)]


def _series(s: Float[Tensor, "*shape"], m: int) -> Float[Tensor, "*shape"]:
    ones = torch.ones_like(s)
    total = ones
    for k in range(N_TERMS, 0, -1):
        total = torch.addcmul(ones, total, s, value=0.25 / (k * (k + m)))
    return total / (2.0**m * math.factorial(m))


def _rms_at_sources(wavenumber: Float[Tensor, " n"]) -> Float[Tensor, "n wave"]:
    """Rms of each wave's field at `SOURCES`, times one over its wavenumber as `bore_field` takes it."""
    reach = SOURCES * wavenumber
    turns = torch.arange(MOST_TURNS + 2, dtype=reach.dtype, device=reach.device)[:, None]
    bessel = reach**turns * torch.stack(_reduced_bessel(reach.square()))
    value, turns = bessel[:-1], turns[:-1]
    slope = turns * value / reach + bessel[1:]
    mean = 0.5 * (slope.square() + (1.0 + (turns / reach).square()) * value.square())
    rms = torch.cat((mean[:1], 0.5 * mean[1:].repeat_interleave(2, dim=0))).sqrt()
    return rms.mT
