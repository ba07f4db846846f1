"""The plot of a registry shows every session by its conclusion and every version by its band."""

from __future__ import annotations

from datetime import UTC, datetime

from matplotlib.colors import to_hex

from estimator.reporting.plots.history import CONCLUSIONS, SessionSummary, VersionInUse, history


def day(number: int) -> datetime:
    return datetime(2026, 1, number, tzinfo=UTC)


def test_sessions_versions_and_causes_are_drawn() -> None:
    radius = {"coil1.radius_m": (0.051, 1e-4)}
    sessions = [
        SessionSummary(day(1), "updated", "", radius),
        SessionSummary(day(2), "unchanged", "", radius),
        SessionSummary(day(3), "rejected", "", {}),
        SessionSummary(day(4), "drifted", "axis gain", {**radius, "axis_gain[hall].x": (0.01, 1e-3)}),
    ]
    bands = {"coil1.radius_m": (0.0508, 0.051, 0.0512)}
    versions = [
        VersionInUse(day(1), day(4), 1, bands),
        VersionInUse(day(4), day(5), 2, {**bands, "axis_gain[hall].x": (0.008, 0.01, 0.012)}),
    ]
    fig = history(sessions, versions, "rig, January")
    strip, radius_panel, gain_panel = fig.axes
    colours = [to_hex(line.get_color()) for line in strip.lines if line.get_marker() != "None"]
    assert colours[: len(sessions)] == [to_hex(CONCLUSIONS[session.conclusion][0]) for session in sessions]
    words = [text.get_text() for text in strip.texts]
    assert words == ["axis gain", "version 1", "version 2"]
    assert radius_panel.get_ylabel() == "radius (mm)"
    assert gain_panel.get_ylabel() == "axis gain x"
    assert len(radius_panel.containers) == 3  # the rejected session says nothing of the radius
    assert len(radius_panel.collections) == 2 + 3
    assert len(gain_panel.containers) == 1
