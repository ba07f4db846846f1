"""Two calibrations side by side in sentences, tables and figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from typing import Any

from estimator.comparison.calibrations import SideBySide, verdict_of
from estimator.errors import listed
from estimator.export.labels import caution_of
from estimator.reporting import plots
from estimator.reporting.numbers import displays, microtesla, size_with_unit
from estimator.reporting.page import Picture, ReportPage, Table, render_report

ROUNDING = 1e-9  # of a number that has no standard deviation


FAR_SD = 3.0  # standard deviations from which two numbers are said to differ


def sentences(compared: SideBySide) -> list[str]:
    """What differs, in words, the most important first."""
    told = []
    for plane in compared.planes:
        there = plane.at_readings
        told.append(
            f"The fields of {plane.coil} differ by {size_with_unit(there.rms_T_per_A, 'T', 3)}/A rms where readings were taken "
            f"({100.0 * there.relative:.2g} % of the field), {there.median_sds:.2g} standard deviations or more at half of the places."
        )
    far = sorted((p for p in compared.numbers if p.distance_sd > FAR_SD), key=lambda p: -p.distance_sd)
    if far:
        names = listed((f"{p.name} ({p.distance_sd:.3g})" for p in far[:5]), len(far))
        told.append(f"Numbers that differ by more than {FAR_SD:g} standard deviations: {names}.")
    else:
        told.append(f"No number differs by more than {FAR_SD:g} standard deviations.")
    if compared.is_same_session:
        told.append(
            "Both come from the same readings: they are not independent, so standard deviations are too wide."
        )
    cautions = zip(compared.names, map(caution_of, compared.calibrations), strict=True)
    return told + [f"{name} is {caution}" for name, caution in cautions if caution]


def number_table(compared: SideBySide) -> Table:
    """The numbers of both, those that differ most first."""
    ordered = sorted(compared.numbers, key=lambda pair: -pair.distance_sd)
    shown = displays([pair.name for pair in ordered])
    rows = []
    for pair in ordered:
        display = shown[pair.name]
        cells = (
            display.with_sd(value, sd) if sd > ROUNDING * abs(value) else f"{value * display.factor:.6g}"
            for value, sd in ((pair.first, pair.first_sd), (pair.second, pair.second_sd))
        )
        distance = f"{pair.distance_sd:.2f}" if math.isfinite(pair.distance_sd) else "—"
        rows.append([pair.name, *cells, display.unit or "1", distance])
    header = ["parameter", "first", "second", "unit", "difference / sd"]
    return Table("Numbers", header, rows, f"First: {compared.names[0]}. Second: {compared.names[1]}.")


def _error_table(compared: SideBySide) -> Table:
    rows = []
    for name, calibration in zip(compared.names, compared.calibrations, strict=True):
        summary = calibration.summary()
        errors: Sequence[Any] = [summary["rmse"][role] for role in ("calibration", "validation")]
        cells = ["—" if error is None else microtesla(error["vector_T"]) for error in errors]
        rows.append([name, verdict_of(calibration) or "—", summary["session_created"][:10], *cells])
    return Table("Errors", ["calibration", "verdict", "recorded", "of the fit", "of validation"], rows)


def side_by_side_report(compared: SideBySide, command: str) -> str:
    """HTML of two calibrations side by side, self-contained."""
    caption = "In the plane through the axis; right: about 1 where both agree, far above it where they contradict each other."
    figures = [
        Picture(
            f"Difference of the fields of {plane.coil}",
            caption,
            partial(
                plots.difference_plane,
                plane.x_m,
                plane.z_m,
                plane.in_plane.size_T_per_A,
                plane.in_plane.sds,
                plane.winding,
                plane.coil,
            ),
        )
        for plane in compared.planes
    ]
    only = [
        f"Only in the {which}: {', '.join(names)}."
        for which, names in zip(("first", "second"), compared.only, strict=True)
        if names
    ]
    page = ReportPage(
        title=f"{compared.names[0]} and {compared.names[1]}",
        subtitle=f"two calibrations of {compared.calibrations[0].rig.name}",
        verdict=[*sentences(compared), *only],
        tables=[number_table(compared), _error_table(compared)],
        figures=figures,
        provenance={"command": command},
    )
    return render_report(page)
