from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.patches import Rectangle

from estimator.reporting.plots import Role, error_budget, evidence_bars, explained_residual, structure_bars
from estimator.reporting.plots.style import BLUE, ORANGE

EVIDENCE = {"nothing": 0.0, "axis_gain": 31.2, "cross_axis": 12.0, "unexplained": 8.5, "backlash": -90.0}


def bars(ax: Axes) -> list[Rectangle]:
    return [bar for group in ax.containers for bar in group]


def labels(ax: Axes) -> list[str]:
    return [label.get_text() for label in ax.get_yticklabels()]


def test_best_hypothesis_stands_on_top_and_the_adopted_one_has_a_colour_of_its_own():
    ax = evidence_bars(EVIDENCE, "axis_gain", title="step 1")
    assert labels(ax) == ["axis_gain", "cross_axis", "nothing wrong", "backlash", "something unlisted"]
    assert ax.yaxis_inverted()
    widths = [bar.get_width() for bar in bars(ax)]
    assert widths[:3] == [31.2, 12.0, 0.0]
    assert widths[4] == 8.5
    colours = [to_hex(bar.get_facecolor()) for bar in bars(ax)]
    assert colours[0] == BLUE.lower()
    assert colours[4] == ORANGE.lower()
    assert len({colours[0], colours[1], colours[4]}) == 3


def test_names_alternatives_unsure_ones_and_what_is_left_are_groups_apart_that_a_legend_explains():
    roles = {"axis_gain": Role.STAND_IN, "cross_axis": Role.NAMED, "iron_body": Role.ALTERNATIVE}
    ax = evidence_bars(EVIDENCE | {"iron_body": 11.0}, "cross_axis", roles)
    assert labels(ax) == [
        *("cross_axis", "iron_body", "axis_gain", "nothing wrong", "backlash", "something unlisted")
    ]
    rows = np.diff(ax.get_yticks())
    assert rows.tolist() == [1.5, 1.5, 1.5, 1.0, 1.5]
    (legend,) = ax.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [*Role, "within 20 to 1 of the best"]
    stated = next(text for text in ax.texts if "stated" in text.get_text())
    assert stated.xy[1] == ax.get_yticks()[0]
    assert (
        len(set(bars(ax)[1].get_facecolor()[:3])) > 1
    )  # an alternative is not as grey as the band behind it


def test_points_lie_on_the_line_where_everything_is_explained():
    rng = np.random.default_rng(1)
    change_T = rng.normal(size=(80, 3)) * 50e-6
    ax = explained_residual(change_T, change_T, 20e-6, title="axis_gain")
    points = [line for line in ax.lines if line.get_linestyle() == "None" and len(line.get_xdata()) == 80]
    assert len(points) == 3
    for line in points:
        assert np.allclose(line.get_xdata(), line.get_ydata())
    assert "µT" in ax.get_xlabel()


def test_structure_is_longer_the_surer_it_is_and_an_arrow_where_no_smaller_p_value_can_be_told():
    floor = 1.0 / 2001.0
    figure = structure_bars(["time", "current", "x"], [floor, 0.5, 1e-9], [0.3, 1.0, 0.002], floor=floor)
    (ax,) = figure.axes
    lengths = [bar.get_width() for bar in bars(ax)]
    before, after = [0.0, -np.log10(0.5), 0.0], [-np.log10(0.3), 0.0, -np.log10(0.002)]
    assert lengths == pytest.approx([*before, *after])
    (arrows,) = ax.lines
    assert arrows.get_xdata() == pytest.approx([-np.log10(floor)] * 2)
    assert arrows.get_ydata() == pytest.approx([-0.2, 1.8])
    assert labels(ax) == ["time", "current", "x"]
    (legend,) = figure.legends
    assert "before: p ≤ 0.0005, the least that the test can tell" in [
        text.get_text() for text in legend.texts
    ]


SHARES = {"axis_gain": (0.71, (0.6, 0.8)), "backlash": (0.1, (-0.05, 0.22)), "left": (0.19, (0.1, 0.3))}
BUDGET_ROLES = [Role.NAMED, Role.STAND_IN, Role.LEFT]


def test_error_budget_shows_shares_in_per_cent_with_their_intervals():
    ax = error_budget(SHARES, BUDGET_ROLES, title="rig")
    assert labels(ax) == list(SHARES)
    assert [bar.get_width() for bar in bars(ax)] == pytest.approx([71.0, 10.0, 19.0])
    intervals = [line.get_xdata() for line in ax.lines if len(set(line.get_xdata())) == 2]
    assert np.allclose(intervals, [[60.0, 80.0], [-5.0, 22.0], [10.0, 30.0]])
    assert [text.get_text().strip() for text in ax.texts] == ["71 %", "10 %", "19 %"]
    assert "%" in ax.get_xlabel()


def test_an_error_budget_shows_all_of_its_intervals_and_explains_its_colours():
    wide = SHARES | {"iron": (1.1, (0.7, 1.6))}
    ax = error_budget(wide, [*BUDGET_ROLES, Role.OTHER])
    low, high = ax.get_xlim()
    assert low <= -5.0
    assert high >= 160.0
    (legend,) = ax.figure.legends
    assert [text.get_text() for text in legend.get_texts()] == [Role.NAMED, Role.STAND_IN, Role.LEFT]
