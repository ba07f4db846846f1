"""What the paper's tables say against each other, in numbers; `docs/paper-errata.md` explains them.

Run `python -m scripts.paper.errata_of_tables`. It needs no data and takes seconds. A printed number stands for all numbers that round to
it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from scripts.paper import printed, programme
from scripts.paper.printed import ERRORS, Errors, interval
from scripts.paper.tables import table

COPPER_OHM_M, COPPER_KG_PER_M3 = 1.72e-8, 8960.0  # at 20 degrees C
UR3_PAYLOAD_KG = 3.0  # data sheet
GRIDS_M = (0.0, 0.0005, 0.001, 0.005, 0.015, 0.04, 0.1)  # nearest plane before the face


def scales() -> str:
    """Absolute over relative error: one divisor for a pair of tables, unless a number is misprinted."""
    rows = []
    for where in ("Tables 4, 5", "Tables 6, 7", "Tables 9, 10"):
        lines = [line for line in ERRORS if line.where == where]
        divisors = {
            f"{line.quantity} {when}": _divisor(line, when) for line in lines for when in ("before", "after")
        }
        for name, (low, high) in divisors.items():
            others = [ends for other, ends in divisors.items() if other != name]
            fits = max(low, *(a for a, _ in others)) <= min(high, *(b for _, b in others))
            common = max(a for a, _ in others), min(b for _, b in others)
            words = (
                ""
                if fits or common[0] > common[1]
                else f"the other three: {common[0]:.4f} to {common[1]:.4f} T"
            )
            rows.append((where, name, f"{low:.4f} to {high:.4f} T", words))
    return table("Absolute over relative error", ("tables", "entry", "divisor", "cannot agree with"), rows)


def _divisor(line: Errors, when: str) -> tuple[float, float]:
    absolute, relative = (
        (line.before_T, line.relative_before) if when == "before" else (line.after_T, line.relative_after)
    )
    (low, high), (least, most) = interval(absolute), interval(relative)
    return low / most, high / least


def repaired() -> str:
    """The two entries that do not fit, replaced by what the other three ask for."""
    sound = {
        "Table 5, rms before": (0.0027, 1.1000e-3, _common("Tables 4, 5", skip=("rms", "before"))),
        "Table 9, largest after": (0.0074, 0.0674, _common("Tables 9, 10", skip=("largest", "after"))),
    }
    rows = []
    for words, (was, other, (low, high)) in sound.items():
        ends = (other / high, other / low) if words.startswith("Table 5") else (other * low, other * high)
        rows.append((words, f"{was:g}", f"{ends[0]:.5f} to {ends[1]:.5f}"))
    return table("What the misprinted entries should be", ("entry", "printed", "by the other three"), rows)


def _common(where: str, skip: tuple[str, str]) -> tuple[float, float]:
    ends = [
        _divisor(line, when)
        for line in ERRORS
        for when in ("before", "after")
        if line.where == where and (line.quantity, when) != skip
    ]
    return max(low for low, _ in ends), min(high for _, high in ends)


def reductions() -> str:
    """Printed percentages beside those of the absolute and of the relative errors."""
    rows = [
        (
            line.where,
            line.quantity,
            f"{line.reduction_percent} %",
            _range(printed.reduction_percent(line.before_T, line.after_T)),
            _range(printed.reduction_percent(line.relative_before, line.relative_after)),
        )
        for line in ERRORS
    ]
    return table(
        "Reductions", ("tables", "error", "printed", "by the absolute errors", "by the relative errors"), rows
    )


def _range(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.1f} to {ends[1]:.1f} %"


def halves() -> str:
    """Largest over rms error with the rms as printed, and as the vector rms that eq 2 makes of it."""
    rows = []
    for where in ("Tables 4, 5", "Tables 6, 7", "Tables 9, 10"):
        largest, rms = (line for line in ERRORS if line.where == where)
        for when, most, mean in (
            ("before", largest.before_T, rms.before_T),
            ("after", largest.after_T, rms.after_T),
        ):
            ratio = float(most) / float(mean)
            verdict = "impossible" if ratio < 2.0 else "nearly one length everywhere" if ratio < 2.3 else ""
            rows.append((where, when, f"{ratio:.2f}", f"{0.5 * ratio:.2f}", verdict))
    header = ("tables", "when", "largest over rms", "largest over vector rms, with the 1/2", "with the 1/2")
    return table("Is the 1/2 of eq 2 in the numbers?", header, rows)


def divisor_meanings() -> str:
    """What the divisor of the relative errors can be: the largest field, or a norm of the matrix of all readings."""
    rows = []
    for where, numbers in (
        ("Tables 4, 5", printed.SIMULATED_TRUTH),
        ("Tables 6, 7", printed.SIMULATED_TRUTH),
        ("Tables 9, 10", printed.CALIBRATED),
    ):
        largest, rms = (line for line in ERRORS if line.where == where)
        divisor_T = float(largest.before_T) / float(largest.relative_before)
        face = programme.field_per_ampere(np.array([[0.0, 0.0, 1e-3]]), numbers)[0, 2]
        # MATLAB's norm of a matrix is its largest singular value; norm(B, 'fro') is the root of the sum of all squares.
        field = programme.field_per_ampere(programme.box_m(round(rms.n_readings ** (1 / 3)), 1e-3), numbers)
        share = float(np.linalg.norm(field, 2) / np.linalg.norm(field))
        cells = []
        for rms_T in (divisor_T / math.sqrt(rms.n_readings), divisor_T / math.sqrt(rms.n_readings) / share):
            before, after = (100 * float(value) / rms_T for value in (rms.before_T, rms.after_T))
            cells += [f"{1e3 * rms_T:.1f} mT", f"{before:.0f} %, {after:.0f} %"]
        rows.append((where, f"{divisor_T:.3f} T", f"{divisor_T / face:.1f} A", *cells))
    header = (
        "tables",
        "divisor",
        "largest field: current at least",
        "Frobenius norm: rms field",
        "rms error over it",
        "MATLAB's norm: rms field",
        "rms error over it",
    )
    return table("What the relative errors are relative to", header, rows)


def expected_errors() -> str:
    """Errors of the start and the end of Table 3 in front of the coil: which grid do Tables 4 and 5 tell of?"""
    rows = [
        ("printed", "", "", *_ratios("Tables 4, 5")),
        ("printed, Table 6", "", "", *_ratios("Tables 6, 7")),
    ]
    for near_m in GRIDS_M:
        box_m = programme.box_m(20, near_m)
        truth, start, found = (
            programme.field_per_ampere(box_m, numbers, is_exact=near_m < 2e-3)
            for numbers in (printed.SIMULATED_TRUTH, printed.SIMULATED_START, printed.SIMULATED_FOUND)
        )
        before, after = (np.linalg.norm(field - truth, axis=1) for field in (start, found))
        rms, before_rms, after_rms = (_rms(v) for v in (np.linalg.norm(truth, axis=1), before, after))
        ratios = (before.max() / before_rms, after.max() / after_rms)
        rows.append((
            f"{1e3 * near_m:g} mm",
            f"{100 * before_rms / rms:.1f} %",
            f"{100 * after_rms / rms:.1f} %",
            f"{100 * (1.0 - after_rms / before_rms):.1f} %",
            *(f"{ratio:.2f}" for ratio in ratios),
        ))  # fmt: skip
    header = (
        "nearest plane",
        "rms error over rms field, before",
        "after",
        "rms less by",
        "largest over vector rms, before",
        "after",
    )
    return table("Table 3's start and end on 20 x 20 x 20 places, 100 x 100 x 50 mm", header, rows)


def beside_the_coil() -> str:
    """Errors of Table 3's end in a plane through the axis, beside the winding and in front of it (Figs 9 and 10)."""
    rows = []
    for where, (near_m, far_m), (back_m, front_m) in (
        ("beside, 1.5 to 20 mm off the winding", (0.0525, 0.0710), (-0.047, 0.0)),
        ("in front, from 1 mm", (0.0, 0.05), (0.001, 0.051)),
        ("in front, from 15 mm", (0.0, 0.05), (0.015, 0.065)),
    ):
        x, z = np.meshgrid(np.linspace(near_m, far_m, 20), np.linspace(back_m, front_m, 20))
        points_m = np.stack((x, 0.0 * x, z), axis=-1).reshape(-1, 3)
        truth, found = (
            programme.field_per_ampere(points_m, numbers, is_exact=True)
            for numbers in (printed.SIMULATED_TRUTH, printed.SIMULATED_FOUND)
        )
        error, size = np.linalg.norm(found - truth, axis=1), np.linalg.norm(truth, axis=1)
        angle = np.arccos(np.clip((found * truth).sum(1) / (np.linalg.norm(found, axis=1) * size), -1.0, 1.0))
        agree = np.corrcoef(error / size, angle)[0, 1]
        rows.append((
            where,
            f"{1e3 * _rms(error):.2f}, {1e3 * error.max():.2f}",
            f"{100 * _rms(error / size):.1f}, {100 * (error / size).max():.1f}",
            f"{1e3 * _rms(angle):.1f}, {1e3 * angle.max():.1f}",
            f"{agree:.2f}",
        ))  # fmt: skip
    header = (
        "places",
        "error: rms, largest (mT/A)",
        "of the field there (%)",
        "angle (mrad)",
        "correlation of relative error and angle",
    )
    return table("Table 3's end beside the winding and in front of it", header, rows)


def _ratios(where: str) -> tuple[str, str, str]:
    largest, rms = (line for line in ERRORS if line.where == where)
    low, high = printed.reduction_percent(rms.before_T, rms.after_T)
    before, after = (
        float(a) / float(b) for a, b in ((largest.before_T, rms.before_T), (largest.after_T, rms.after_T))
    )
    return f"{0.5 * (low + high):.1f} %", f"{before:.2f}", f"{after:.2f}"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def sensor_of_table_8() -> str:
    """Where Table 8's pose puts the sensor, with the rotation as eq 22 uses it and the other way round."""
    rows = []
    for words, pose, numbers in (
        ("measured", printed.MEASURED_POSE, printed.MEASURED),
        ("calibrated", printed.CALIBRATED_POSE, printed.CALIBRATED),
    ):
        turn = programme.coil_from_world(np.array(pose))
        inner_mm = numbers[0] - 2.0 * numbers[1] * numbers[3]
        for way, rotation in (("as printed", turn.T), ("the other way", turn)):
            x, y, z = -rotation @ np.array(pose[:3])
            rho, depth = math.hypot(x, y), 2.0 * numbers[1] * numbers[2]
            is_inside = -depth < z < 0.0 and inner_mm < rho < numbers[0]
            place = "inside the copper" if is_inside else f"{z:.1f} mm in front of the face"
            rows.append((words, way, f"({x:.1f}, {y:.1f}, {z:.1f})", f"{rho:.1f}", place))
    header = ("pose", "rotation", "sensor in the coil frame (mm)", "off the axis (mm)", "place")
    return table("Table 8: the sensor in the reference configuration", header, rows)


def windings() -> str:
    """Turns, length, bore, resistance and mass of each winding of Tables 3 and 8, copper throughout."""
    rows = []
    for words, (radius_mm, wire_mm, axial, radial) in {
        "Table 3, truth": printed.SIMULATED_TRUTH,
        "Table 3, start": printed.SIMULATED_START,
        "Table 3, found": printed.SIMULATED_FOUND,
        "Table 8, measured": printed.MEASURED,
        "Table 8, calibrated": printed.CALIBRATED,
    }.items():
        turns, section_m2 = axial * radial, math.pi * (1e-3 * wire_mm) ** 2
        length_m = 2e-3 * math.pi * (radius_mm - wire_mm * radial) * turns
        cells = (2 * wire_mm * axial, radius_mm - 2 * wire_mm * radial, COPPER_OHM_M * length_m / section_m2)
        kilograms = COPPER_KG_PER_M3 * length_m * section_m2
        rows.append((words, f"{turns:.0f}", *(f"{cell:.2f}" for cell in cells), f"{kilograms:.2f}"))
    header = (
        "winding",
        "turns",
        "length (mm)",
        "inner radius (mm)",
        "least resistance (ohm)",
        "most mass (kg)",
    )
    title = f"Windings of bare copper; a UR3 carries {UR3_PAYLOAD_KG:g} kg"
    return table(title, header, rows)


def shifts() -> str:
    """Table 3: distance to the truth before and after the calibration."""
    rows = []
    names = ("external radius (mm)", "wire radius (mm)", "axial loops", "radial loops")
    for name, truth, start, found in zip(
        names, printed.SIMULATED_TRUTH, printed.SIMULATED_START, printed.SIMULATED_FOUND, strict=True
    ):
        before, after = start - truth, found - truth
        rows.append(
            (name, f"{before:+g}", f"{after:+.4g}", "further" if abs(after) > abs(before) else "nearer")
        )
    return table("Table 3: off the truth", ("parameter", "before", "after", "calibration brought it"), rows)


def position_error() -> str:
    """How far an arm must miss its targets to leave Table 9's error, by the field's slope on the grid."""
    rows = []
    for near_m in (0.001, 0.0145):
        places_m = programme.box_m(8, near_m)
        numbers = printed.CALIBRATED
        step_m = 1e-5
        slopes = [
            programme.field_per_ampere(places_m + step_m * axis, numbers) - programme.field_per_ampere(places_m - step_m * axis, numbers)
            for axis in np.eye(3)
        ]  # fmt: skip
        slope = _rms(np.linalg.norm(np.stack(slopes) / (2.0 * step_m), axis=(0, 2))) / math.sqrt(3.0)
        field = _rms(np.linalg.norm(programme.field_per_ampere(places_m, numbers), axis=1))
        for words, current_A in _currents(field):
            rows.append(
                (
                    f"{1e3 * near_m:g}",
                    words,
                    f"{current_A:.2f}",
                    f"{1e3 * 2.7e-3 / (math.sqrt(3.0) * slope * current_A):.2f}",
                )
            )
    header = ("nearest plane (mm)", "divisor of Table 10", "current (A)", "miss along each axis, rms (mm)")
    return table("Position error that leaves 2.7 mT", header, rows)


def _currents(rms_field_T_per_A: float) -> Iterable[tuple[str, float]]:
    norm_T = 0.0043 / 0.0414
    yield "norm of all readings", norm_T / math.sqrt(512.0) / rms_field_T_per_A
    face = programme.field_per_ampere(np.array([[0.0, 0.0, 1e-3]]), printed.CALIBRATED)[0, 2]
    yield "largest field", norm_T / face


def study() -> str:
    """All tables of this file."""
    parts = (
        scales,
        repaired,
        reductions,
        halves,
        divisor_meanings,
        expected_errors,
        beside_the_coil,
        shifts,
        windings,
        sensor_of_table_8,
        position_error,
    )
    return "\n".join(part() for part in parts)


def main() -> None:
    print(study())


if __name__ == "__main__":
    main()
