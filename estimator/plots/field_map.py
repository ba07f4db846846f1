"""Where in front of the coil the model is good: maps over the places of the sensor, and the field with its error.

All positions are in the coil frame: the winding, drawn grey, has its front face at z = 0 and +z points away from it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Annulus, Rectangle

from estimator.errors import InvalidInput
from estimator.field.winding import Winding
from estimator.plots.style import (
    BLACK,
    ERROR_MAP,
    FIELD_MAP,
    SIDE_AND_DATA,
    WIDTH_MAP,
    WINDING,
    WINDING_EDGE,
    figure,
    styled,
)

Vectors = Float[np.ndarray, "reading 3"]
CELLS_ACROSS = 24
MOST_LAYERS = 40
SAME_LAYER = 0.01
CLEAR_GAP = 3.0
LONGEST_PANEL = 4.0
MEDIAN_OF_MAXWELL = 1.538


@styled
def residual_map(
    positions_m: Vectors, residual_T: Vectors, winding: Winding, sigma_T: float | None = None, title: str = ""
) -> Figure:
    """Length of the residual vector over the places, in µT.

    Args:
        positions_m: Sensor in the coil frame.
        residual_T: Measured minus predicted, in any frame; NaN where a component was not measured.
        winding: The coil's, one value each.
        sigma_T: Noise of one component; its typical length is then marked beside the colours.
        title: Rig and date.
    """
    length_uT = _length(residual_T) * 1e6
    noise_uT = None if sigma_T is None else sigma_T * 1e6 * MEDIAN_OF_MAXWELL
    return _two_planes(positions_m, length_uT, winding, "|measured − predicted| (µT)", title, noise_uT)


@styled
def relative_error_map(
    positions_m: Vectors, measured_T: Vectors, predicted_T: Vectors, winding: Winding, title: str = ""
) -> Figure:
    """Length of the residual vector over that of the measured one, in per cent; arguments as in `residual_map`."""
    percent = 100.0 * _length(measured_T - predicted_T) / _length(measured_T)
    return _two_planes(positions_m, percent, winding, "|measured − predicted| / |measured| (%)", title)


@styled
def angular_deviation_map(
    positions_m: Vectors, measured_T: Vectors, predicted_T: Vectors, winding: Winding, title: str = ""
) -> Figure:
    """Angle between measured and predicted field, in mrad, where all three components were measured."""
    sine = np.linalg.norm(np.cross(measured_T, predicted_T), axis=1)
    angle_mrad = 1e3 * np.arctan2(sine, np.sum(measured_T * predicted_T, axis=1))
    return _two_planes(positions_m, angle_mrad, winding, "angle between measured and predicted (mrad)", title)


@styled
def field_plane(
    x_m: Float[np.ndarray, " x"],
    z_m: Float[np.ndarray, " z"],
    field_T: Float[np.ndarray, "z x 3"],
    relative_half_width: Float[np.ndarray, "z x"],
    winding: Winding,
    readings_m: Vectors | None = None,
    title: str = "",
) -> Figure:
    """Calibrated field in the plane y = 0 of the coil frame, and how well it is known.

    Args:
        x_m: Across the axis, evenly spaced, increasing.
        z_m: Along the axis, likewise.
        field_T: Field in the coil frame; what lies inside the winding is hidden.
        relative_half_width: Half of the 90 % interval of |B| over |B|.
        winding: The coil's, one value each.
        readings_m: Places of the sensor in the coil frame; outside of them the model extrapolates.
        title: Rig, date and the coil's current.
    """
    made = figure(10.0, 4.6, title)
    left, right = made.subplots(1, 2, sharex=True, sharey=True)
    x_mm, z_mm = x_m * 1e3, z_m * 1e3
    across_m = np.abs(x_m)[None, :]
    inner_m = float(winding.radius_m - winding.thickness_m)
    is_beside = (z_m > 0.0) | (z_m < -float(winding.length_m))
    is_outside = (across_m < inner_m) | (across_m > float(winding.radius_m)) | is_beside[:, None]
    size_mT = np.linalg.norm(field_T, axis=-1) * 1e3
    low, high = np.quantile(size_mT[is_outside], (0.01, 0.995))
    levels = np.geomspace(low, high, 13)
    filled = left.contourf(x_mm, z_mm, size_mT, levels, norm=LogNorm(), cmap=FIELD_MAP, extend="both")
    across, along = field_T[..., 0], field_T[..., 2]
    left.streamplot(x_mm, z_mm, across, along, color="white", linewidth=0.6, arrowsize=0.7, density=0.9)
    made.colorbar(filled, ax=left, label="|B| (mT)", format="%.3g")
    left.set_title("field and its lines, y = 0")
    percent = 100.0 * relative_half_width
    top = float(np.quantile(percent[is_outside], 0.98))
    filled = right.contourf(x_mm, z_mm, percent, np.linspace(0.0, top, 13), cmap=WIDTH_MAP, extend="max")
    made.colorbar(filled, ax=right, label="half-width of the 90 % interval of |B| (%)", format="%.2g")
    right.set_title("how well it is known")
    for ax in (left, right):
        _draw_winding(ax, winding, "z", zorder=3.0)
        ax.set(xlim=x_mm[[0, -1]], ylim=z_mm[[0, -1]], aspect="equal", xlabel="x (mm)")
    if readings_m is not None:
        places = np.unique(np.round(readings_m[:, [0, 2]], 3), axis=0) * 1e3
        right.plot(*places.T, ".", color="white", mec=BLACK, mew=0.3, ms=3, label="readings", zorder=4)
        right.legend(loc="upper right", frameon=True, fontsize=8)
    left.set_ylabel("z (mm)")
    return made


def _two_planes(
    positions_m: Vectors,
    values: np.ndarray,
    winding: Winding,
    label: str,
    title: str,
    noise: float | None = None,
) -> Figure:
    """Values at the places from the side (XZ) and from the front (XY); the median over the hidden axis."""
    is_known = np.isfinite(values)
    if not is_known.any():
        raise InvalidInput(f"a map of {label} needs readings of the field's components; received none")
    places_mm, values = positions_m[is_known] * 1e3, values[is_known]
    layers = np.stack([_layers(places_mm[:, axis]) for axis in range(3)], axis=1)
    cell_mm = np.ptp(places_mm, axis=0) / np.maximum(layers.max(0), 1)
    seen = {axes: _medians(places_mm, values, layers, axes) for axes in ((0, 2), (0, 1))}
    typical = max(float(np.quantile(medians, 0.98)) for _, medians in seen.values())
    top = max(typical, 2.0 * (noise or 0.0)) or 1.0

    made = figure(9.0, 4.2, title)
    panels = made.subplots(1, 2)
    for ax, ((_, up), (centres, medians)) in zip(panels, seen.items(), strict=True):
        _frame(ax, places_mm[:, (0, up)], winding, up)
        drawn = _discs(ax, centres, medians, cell_mm[[0, up]], top)
    bar = made.colorbar(drawn, ax=panels, label=label, extend="max")
    if noise is not None:
        bar.ax.axhline(noise, color="white", lw=3.0)
        bar.ax.axhline(noise, color=BLACK, lw=1.2)
        place = (-0.3, noise)
        bar.ax.annotate("noise\nalone", place, xycoords=SIDE_AND_DATA, ha="right", va="center", fontsize=8)
    return made


def _frame(ax: Axes, places_mm: np.ndarray, winding: Winding, up: int) -> None:
    """Winding, limits, labels and shape of the panel with x across and axis number `up` upwards."""
    _draw_winding(ax, winding, "xyz"[up])
    radius_mm, length_mm = float(winding.radius_m) * 1e3, float(winding.length_m) * 1e3
    low = np.minimum(places_mm.min(0), (-radius_mm, -length_mm if up == 2 else -radius_mm))
    high = np.maximum(places_mm.max(0), (radius_mm, 0.0 if up == 2 else radius_mm))
    span, margin = high - low, 0.06 * (high - low).max()
    ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    ax.set_aspect("equal" if span.max() < LONGEST_PANEL * span.min() else "auto")
    ax.set(xlabel="x (mm)", ylabel=f"{'xyz'[up]} (mm)", title=f"X{'XYZ'[up]}: median over {'xzy'[up]}")


def _discs(
    ax: Axes, centres_mm: np.ndarray, values: np.ndarray, cell_mm: np.ndarray, top: float
) -> EllipseCollection:
    """One disc per cell, nearly as large as the cell."""
    if ax.get_aspect() != "auto":
        cell_mm = np.full(2, cell_mm[cell_mm > 0.0].min() if cell_mm.any() else 1.0)
    size = 0.92 * np.maximum(cell_mm, 1e-9)
    n = len(values)
    discs = EllipseCollection(
        [size[0]] * n,
        [size[1]] * n,
        [0.0] * n,
        units="xy",
        offsets=centres_mm,
        offset_transform=ax.transData,
        array=values,
        cmap=ERROR_MAP,
        clim=(0.0, top),
    )
    ax.add_collection(discs, autolim=False)
    return discs


def _draw_winding(ax: Axes, winding: Winding, up: str, zorder: float = 0.5) -> None:
    """The winding's section in XZ (two rectangles), or its outline from the front in XY (a ring), in mm."""
    sizes_m = (winding.radius_m, winding.thickness_m, winding.length_m)
    radius, thickness, length = (1e3 * float(size_m) for size_m in sizes_m)
    style: dict[str, Any] = {"facecolor": WINDING, "edgecolor": WINDING_EDGE, "lw": 0.8, "zorder": zorder}
    if up == "y":
        ax.add_patch(Annulus((0.0, 0.0), radius, min(thickness, 0.999 * radius), **style))
    else:
        ax.add_patch(Rectangle((radius - thickness, -length), thickness, length, **style))
        ax.add_patch(Rectangle((-radius, -length), thickness, length, **style))


def _length(vectors: np.ndarray) -> np.ndarray:
    """Length over the components that were measured; NaN where none was."""
    return np.where(np.isfinite(vectors).any(axis=1), np.sqrt(np.nansum(vectors**2, axis=1)), np.nan)


def _layers(coordinate_mm: np.ndarray) -> np.ndarray:
    """Index of every place's layer: a layer of the grid (which may be tilted a little), else one of equal slices."""
    order = np.argsort(coordinate_mm, kind="stable")
    ordered = coordinate_mm[order]
    extent = float(ordered[-1] - ordered[0])
    if extent == 0.0:
        return np.zeros(len(ordered), int)
    gap = np.diff(ordered)
    ranked = np.sort(np.maximum(gap, SAME_LAYER * extent))[::-1][:MOST_LAYERS]
    ratio = ranked[:-1] / ranked[1:]
    index = np.empty(len(ordered), int)
    if len(ratio) and ratio.max() > CLEAR_GAP:
        smallest = ranked[int(ratio.argmax())]
        index[order] = np.concatenate(([0], np.cumsum(gap >= smallest)))
        if max(np.ptp(coordinate_mm[index == i]) for i in range(index.max() + 1)) < smallest:
            return index
    index[order] = np.minimum((ordered - ordered[0]) / extent * CELLS_ACROSS, CELLS_ACROSS - 1).astype(int)
    return index


def _medians(
    places_mm: np.ndarray, values: np.ndarray, layers: np.ndarray, axes: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Middle of the places and median of the values that share both layers."""
    distinct, cell = np.unique(layers[:, axes], axis=0, return_inverse=True)
    of_cell = [cell.ravel() == i for i in range(len(distinct))]
    centres = np.array([np.median(places_mm[m][:, axes], axis=0) for m in of_cell]).reshape(-1, 2)
    return centres, np.array([np.median(values[m]) for m in of_cell])
