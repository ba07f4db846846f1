"""Maps of the model's error over the positions of the sensor, in the frame of a coil.

The winding, drawn grey, has its front face at z = 0, and +z points away from it. A panel shows one plane. Readings that share a position in
it form one disc, coloured by their median.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from estimator.errors import InvalidInput
from estimator.field.winding import Winding
from estimator.reporting.plots.field_map import draw_winding
from estimator.reporting.plots.style import BLACK, ERROR_MAP, SIDE_AND_DATA, WINDING_EDGE, figure, styled

Vectors = Float[np.ndarray, "reading 3"]
SMALLEST_DISC = 0.03  # of a panel's width: places nearly in a line have cells that nobody would see
CELLS_ACROSS = 24
MOST_LAYERS = 40
SAME_LAYER = 0.01
CLEAR_GAP = 3.0
LONGEST_PANEL = 4.0
MEDIAN_OF_MAXWELL = 1.538
NOISE_STAYS_PALE = 4.0


@styled
def residual_map(
    positions_m: Vectors,
    residual_T: Vectors,
    winding: Winding | None,
    sigma_T: float | None = None,
    title: str = "",
) -> Figure:
    """Length of the residual vector at the sensor positions, in µT.

    Args:
        positions_m: Sensor positions in the coil frame.
        residual_T: Measured minus predicted, in any frame; NaN where a component was not measured.
        winding: Winding of the coil (no batch); None where it is not known.
        sigma_T: Noise of one component; if given, the median length of pure noise is marked on the colour bar.
        title: Rig and date.
    """
    length_uT = _length(residual_T) * 1e6
    noise_uT = None if sigma_T is None else sigma_T * 1e6 * MEDIAN_OF_MAXWELL
    return _panels(positions_m, {"": length_uT}, winding, "|measured − predicted| (µT)", title, noise_uT)


@styled
def relative_error_map(
    positions_m: Vectors, measured_T: Vectors, predicted_T: Vectors, winding: Winding | None, title: str = ""
) -> Figure:
    """Length of the residual vector relative to the measured one, in per cent; arguments as in `residual_map`."""
    size_T = _length(measured_T)
    percent = 100.0 * _length(measured_T - predicted_T) / np.where(size_T > 0.0, size_T, np.nan)
    return _panels(positions_m, {"": percent}, winding, "|measured − predicted| / |measured| (%)", title)


@styled
def angular_deviation_map(
    positions_m: Vectors, measured_T: Vectors, predicted_T: Vectors, winding: Winding | None, title: str = ""
) -> Figure:
    """Angle between measured and predicted field, in mrad, where all three components were measured."""
    sine = np.linalg.norm(np.cross(measured_T, predicted_T), axis=1)
    angle_mrad = 1e3 * np.arctan2(sine, np.sum(measured_T * predicted_T, axis=1))
    return _panels(
        positions_m, {"": angle_mrad}, winding, "angle between measured and predicted (mrad)", title
    )


@styled
def before_and_after_map(
    positions_m: Vectors,
    before_T: Vectors,
    after_T: Vectors,
    winding: Winding | None,
    sigma_T: float | None = None,
    title: str = "",
) -> Figure:
    """Length of the residual under two models at the same positions and in the same colours, in µT; arguments as in `residual_map`."""
    noise_uT = None if sigma_T is None else sigma_T * 1e6 * MEDIAN_OF_MAXWELL
    rows = {"before": _length(before_T) * 1e6, "after": _length(after_T) * 1e6}
    return _panels(positions_m, rows, winding, "|measured − predicted| (µT)", title, noise_uT)


def _panels(
    positions_m: Vectors,
    rows: Mapping[str, np.ndarray],
    winding: Winding | None,
    label: str,
    title: str,
    noise: float | None = None,
) -> Figure:
    """A row of panels for each set of values: from the side (XZ) and from the front (XY), median over the hidden axis."""
    is_known = np.isfinite(np.stack(list(rows.values()))).all(axis=0)
    if not is_known.any():
        raise InvalidInput(f"a map of {label} needs readings of the field's components; received none")
    positions_mm = positions_m[is_known] * 1e3
    same_mm = SAME_LAYER * float(np.ptp(positions_mm, axis=0).max())
    layers = np.empty(positions_mm.shape, int)
    for axis in range(3):
        layers[:, axis], positions_mm[:, axis] = _layers(positions_mm[:, axis], same_mm)
    cell_mm = np.ptp(positions_mm, axis=0) / np.maximum(layers.max(0), 1)
    cell_mm = np.where(cell_mm > 0.0, cell_mm, cell_mm.max() or 1.0)
    seen = [
        [(row, up, *_medians(positions_mm, values[is_known], layers, (0, up))) for up in (2, 1)]
        for row, values in rows.items()
    ]
    typical = max(float(np.quantile(medians, 0.98)) for row in seen for *_, medians in row)
    top = max(typical, NOISE_STAYS_PALE * (noise or 0.0)) or 1.0

    fig = figure(9.0, 0.6 + 3.6 * len(rows), title)
    panels = fig.subplots(len(rows), 2, squeeze=False)
    for line, row in zip(panels, seen, strict=True):
        for ax, (name, up, centres, medians) in zip(line, row, strict=True):
            _frame(ax, positions_mm[:, (0, up)], winding, up, cell_mm[[0, up]])
            drawn = _discs(ax, centres, medians, cell_mm[[0, up]], top)
            if name:
                ax.set_title(f"{name}, {ax.get_title()}")
    bar = fig.colorbar(drawn, ax=panels, label=label, extend="max")
    if noise is not None:
        bar.ax.axhline(noise, color="white", lw=3.0)
        bar.ax.axhline(noise, color=BLACK, lw=1.2)
        bar.ax.annotate(
            "noise\nalone", (-0.3, noise), xycoords=SIDE_AND_DATA, ha="right", va="center", fontsize=8
        )
    return fig


def _frame(ax: Axes, positions_mm: np.ndarray, winding: Winding | None, up: int, cell_mm: np.ndarray) -> None:
    """Draw the winding and set limits, labels and aspect of a panel with x across and axis number `up` upwards."""
    low, high = positions_mm.min(0) - 0.5 * cell_mm, positions_mm.max(0) + 0.5 * cell_mm
    if winding is not None:
        draw_winding(ax, winding, "xyz"[up])
        radius_mm, length_mm = float(winding.radius_m) * 1e3, float(winding.length_m) * 1e3
        low = np.minimum(low, (-radius_mm, -length_mm if up == 2 else -radius_mm))
        high = np.maximum(high, (radius_mm, 0.0 if up == 2 else radius_mm))
    span, margin = high - low, 0.03 * (high - low)
    ax.set(xlim=(low[0] - margin[0], high[0] + margin[0]), ylim=(low[1] - margin[1], high[1] + margin[1]))
    ax.set_aspect("equal" if span.max() < LONGEST_PANEL * span.min() else "auto")
    ax.set(xlabel="x (mm)", ylabel=f"{'xyz'[up]} (mm)", title=f"X{'XYZ'[up]}: median over {'xzy'[up]}")


def _discs(
    ax: Axes, centres_mm: np.ndarray, values: np.ndarray, cell_mm: np.ndarray, top: float
) -> EllipseCollection:
    """Draw one disc per cell, nearly as large as the cell."""
    if ax.get_aspect() != "auto":
        low_mm, high_mm = ax.get_xlim()
        cell_mm = np.full(2, max(cell_mm.min(), SMALLEST_DISC * (high_mm - low_mm)))
    size, n = 0.92 * cell_mm, len(values)
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
        edgecolor=WINDING_EDGE,
        linewidth=0.3,
    )
    ax.add_collection(discs, autolim=False)
    return discs


def _length(vectors: np.ndarray) -> np.ndarray:
    """Length over the measured components; NaN if none was measured."""
    return np.where(np.isfinite(vectors).any(axis=1), np.sqrt(np.nansum(vectors**2, axis=1)), np.nan)


def _layers(coordinate_mm: np.ndarray, same_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """Layer of every position, and the coordinate at which it is drawn.

    Layers are those of the grid, which may be tilted a little. Positions without a grid are cut into equal slices, drawn at their middles.
    Coordinates within `same_mm` form one layer.
    """
    index = np.zeros(len(coordinate_mm), int)
    extent = float(np.ptp(coordinate_mm))
    if extent <= same_mm:
        return index, np.full_like(coordinate_mm, np.median(coordinate_mm))
    order = np.argsort(coordinate_mm, kind="stable")
    gap = np.diff(coordinate_mm[order])
    ranked = np.sort(np.maximum(gap, SAME_LAYER * extent))[::-1][:MOST_LAYERS]
    ratio = ranked[:-1] / ranked[1:]
    if len(ratio) and ratio.max() > CLEAR_GAP:
        smallest_gap = ranked[int(ratio.argmax())]
        index[order[1:]] = np.cumsum(gap >= smallest_gap)
        if max(np.ptp(coordinate_mm[index == i]) for i in range(index.max() + 1)) < smallest_gap:
            return index, coordinate_mm
    slice_mm = extent / CELLS_ACROSS
    low = coordinate_mm.min()
    index = np.minimum((coordinate_mm - low) / slice_mm, CELLS_ACROSS - 1).astype(int)
    return index, low + (index + 0.5) * slice_mm


def _medians(
    positions_mm: np.ndarray, values: np.ndarray, layers: np.ndarray, axes: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Median position and median value of the readings that share both layers."""
    distinct, cell = np.unique(layers[:, axes], axis=0, return_inverse=True)
    of_cell = [cell.ravel() == i for i in range(len(distinct))]
    centres = np.array([np.median(positions_mm[m][:, axes], axis=0) for m in of_cell]).reshape(-1, 2)
    return centres, np.array([np.median(values[m]) for m in of_cell])
