from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from estimator.reporting.plots import (
    Role,
    evidence_bars,
    explained_residual,
    stepwise_residual,
    structure_bars,
)
from estimator.reporting.plots.style import BLUE, ORANGE

EVIDENCE = {"nothing": 0.0, "axis_gain": 31.2, "cross_axis": 12.0, "unexplained": 8.5, "backlash": -90.0}


def bars(ax: Axes) -> list[Rectangle]:
    return [bar for group in ax.containers for bar in group]


def labels(ax: Axes) -> list[str]:
    return [label.get_text() for label in ax.get_yticklabels()]


def test_best_hypothesis_stands_on_top_and_the_adopted_one_has_a_colour_of_its_own() -> None:
    ax = evidence_bars(EVIDENCE, "axis_gain", title="step 1")
    assert labels(ax) == ["axis_gain", "cross_axis", "nothing wrong", "backlash", "a flexible curve"]
    assert ax.yaxis_inverted()
    widths = [bar.get_width() for bar in bars(ax)]
    assert widths[:3] == [31.2, 12.0, 0.0]
    assert widths[4] == 8.5
    colours = [to_hex(bar.get_facecolor()) for bar in bars(ax)]
    assert colours[0] == BLUE.lower()
    assert colours[4] == ORANGE.lower()
    assert len({colours[0], colours[1], colours[4]}) == 3


def test_names_stand_ins_and_what_is_left_are_groups_apart_that_a_legend_explains() -> None:
    roles = {"axis_gain": Role.STAND_IN, "cross_axis": Role.NAMED}
    ax = evidence_bars(EVIDENCE, "axis_gain", roles)
    assert labels(ax) == ["cross_axis", "axis_gain", "nothing wrong", "backlash", "a flexible curve"]
    rows = np.diff(ax.get_yticks())
    assert rows.tolist() == [1.5, 1.5, 1.0, 1.5]
    (legend,) = ax.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*Role, "within 20 to 1 of the best"]
    taken = next(text for text in ax.texts if "taken here" in text.get_text())
    assert taken.xy[1] == ax.get_yticks()[1]


def test_hopeless_hypotheses_are_cut_off_and_said_to_be(words: Callable[[Axes | Figure], str]) -> None:
    ax = evidence_bars(EVIDENCE, "axis_gain")
    assert bars(ax)[3].get_width() > -20.0
    assert "< −8" in words(ax)


def test_nothing_and_the_unexplained_are_shown_however_far_behind() -> None:
    evidence = {f"cause{i}": 50.0 - i for i in range(30)} | {"nothing": 0.0, "unexplained": -2.0}
    names = labels(evidence_bars(evidence))
    assert {"nothing wrong", "a flexible curve"} <= set(names)
    assert len(names) == 12


def test_points_lie_on_the_line_where_everything_is_explained() -> None:
    rng = np.random.default_rng(1)
    change_T = rng.normal(size=(80, 3)) * 50e-6
    ax = explained_residual(change_T, change_T, 20e-6, title="axis_gain")
    points = [line for line in ax.lines if line.get_linestyle() == "None" and len(line.get_xdata()) == 80]
    assert len(points) == 3
    for line in points:
        assert np.allclose(line.get_xdata(), line.get_ydata())
    assert "µT" in ax.get_xlabel()


def test_missing_components_are_left_out_of_the_picture() -> None:
    change_T = np.full((30, 3), np.nan)
    change_T[:, 2] = np.linspace(-1e-5, 1e-5, 30)
    ax = explained_residual(change_T, change_T, 1e-6)
    assert [text.get_text() for text in ax.get_legend().get_texts() if text.get_text().startswith("B")] == [
        "Bz"
    ]


def test_structure_is_longer_the_surer_it_is_and_ends_at_the_smallest_shown() -> None:
    figure = structure_bars(["time", "current"], [1e-9, 0.5], [0.3, 1.0])
    (ax,) = figure.axes
    lengths = [bar.get_width() for bar in bars(ax)]
    assert lengths == pytest.approx([4.0, -np.log10(0.5), -np.log10(0.3), 0.0])
    assert labels(ax) == ["time", "current"]


def test_stepwise_residual_shows_what_remains_after_each_cause():
    ax = stepwise_residual(
        ["axis_gain[hall]", "mount_tilt[coil1]"], [40e-6, 25e-6, 20e-6], [31.4, 8.0], title="rig"
    )
    assert labels(ax) == ["rig as described", "+ axis_gain[hall]", "+ mount_tilt[coil1]"]
    assert [bar.get_width() for bar in ax.patches] == pytest.approx([40.0, 25.0, 20.0])
    annotations = [text.get_text().strip() for text in ax.texts]
    assert annotations == ["40 µT", "25 µT, log evidence +31", "20 µT, log evidence +8"]
    large = stepwise_residual(["iron_plate[room]"], [4.25e-3, 2.9e-3], [604.0])
    assert [text.get_text().strip() for text in large.texts] == ["4.25 mT", "2.9 mT, log evidence +604"]
    assert "mT" in large.get_xlabel()


def test_stepwise_residual_ends_with_what_is_left_beyond_the_noise():
    roles = [Role.NAMED, Role.STAND_IN]
    ax = stepwise_residual(["axis_gain", "backlash"], [40e-6, 25e-6, 5e-6], [31.4, 8.0], roles, 3e-6)
    assert labels(ax)[-1] == "left beyond the noise"
    assert ax.patches[-1].get_width() == pytest.approx(4.0)
    (legend,) = ax.figure.legends
    shown = [Role.NAMED, Role.STAND_IN, Role.LEFT, "noise alone"]
    assert [text.get_text() for text in legend.get_texts()] == shown
