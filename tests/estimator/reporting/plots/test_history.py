"""The picture of a registry shows every session by its conclusion and every version by its band."""

from __future__ import annotations

from datetime import UTC, datetime

from matplotlib.colors import to_hex

from estimator.reporting.plots.history import CONCLUSIONS, InUse, Visit, history


def day(number: int) -> datetime:
    return datetime(2026, 1, number, tzinfo=UTC)


def test_sessions_versions_and_causes_are_drawn() -> None:
    radius = {"coil1.radius_m": (0.051, 1e-4)}
    visits = [
        Visit(day(1), "updated", "", radius),
        Visit(day(2), "unchanged", "", radius),
        Visit(day(3), "rejected", "", {}),
        Visit(day(4), "drifted", "axis gain", {**radius, "axis_gain[hall].x": (0.01, 1e-3)}),
    ]
    bands = {"coil1.radius_m": (0.0508, 0.051, 0.0512)}
    in_use = [
        InUse(day(1), day(4), 1, bands),
        InUse(day(4), day(5), 2, {**bands, "axis_gain[hall].x": (0.008, 0.01, 0.012)}),
    ]
    made = history(visits, in_use, "rig, January")
    strip, radius_panel, gain_panel = made.axes
    colours = [to_hex(line.get_color()) for line in strip.lines if line.get_marker() != "None"]
    assert colours[: len(visits)] == [to_hex(CONCLUSIONS[visit.conclusion][0]) for visit in visits]
    words = [text.get_text() for text in strip.texts]
    assert words == ["axis gain", "version 1", "version 2"]
    assert radius_panel.get_ylabel() == "radius (mm)"
    assert gain_panel.get_ylabel() == "axis gain x"
    assert len(radius_panel.containers) == 3  # the rejected session says nothing of the radius
    assert len(radius_panel.collections) == 2 + 3
    assert len(gain_panel.containers) == 1
