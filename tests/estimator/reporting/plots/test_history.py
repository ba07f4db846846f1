"""The plot of a registry shows every session by its conclusion and every version by its band."""

from __future__ import annotations

from datetime import UTC, datetime

from matplotlib.colors import to_hex

from estimator.reporting.plots.history import CONCLUSIONS, SessionSummary, VersionInUse, history


def day(number: int) -> datetime:
    return datetime(2026, 1, number, tzinfo=UTC)


def test_sessions_versions_and_causes_are_drawn():
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
    strip, gain_panel, radius_panel = fig.axes
    colours = [to_hex(line.get_color()) for line in strip.lines if line.get_marker() != "None"]
    assert colours[: len(sessions)] == [to_hex(CONCLUSIONS[session.conclusion][0]) for session in sessions]
    words = [text.get_text() for text in strip.texts]
    assert words == ["axis gain", " version 1", " version 2"]
    assert radius_panel.get_ylabel() == "radius (mm)"
    assert gain_panel.get_ylabel() == "axis gain x"
    assert len(radius_panel.containers) == 3  # the rejected session says nothing of the radius
    assert len(radius_panel.collections) == 2 + 3
    assert len(gain_panel.containers) == 1


def test_labels_of_close_sessions_and_versions_do_not_lie_on_each_other():
    sessions = [SessionSummary(day(1), "updated", "", {})]
    close = [2, 2, 3, 3, 4, 4, 5, 20]
    sessions += [SessionSummary(day(n), "drifted", f"axis gain of sensor {n}", {}) for n in close]
    versions = [
        VersionInUse(day(n), day(n + 1), n, {"coil1.radius_m": (1.0, 2.0, 3.0)}) for n in (1, 2, 3, 20)
    ]
    fig = history(sessions, versions, "rig")
    fig.canvas.draw()
    strip = fig.axes[0]
    boxes = [text.get_window_extent() for text in strip.texts]
    texts = [text.get_text().strip() for text in strip.texts]
    assert (
        len([text for text in texts if text.startswith("axis gain")]) == 4
    )  # three lines for the first seven, and the last
    assert {"version 1", "version 2", "version 20"} <= set(texts)
    overlaps = [
        (a, b)
        for i, a in enumerate(texts)
        for j, b in enumerate(texts)
        if i < j and boxes[i].overlaps(boxes[j])
    ]
    assert overlaps == []
