"""What studies of the open world count: names, probabilities and verdicts as `diagnosis.json` writes them, with and without the unknown."""

from __future__ import annotations

from typing import Any

import pytest

from estimator.effects import EFFECTS, ORDER
from scripts.studies.leave_one_out import mark, says_unknown, without, wrong_names
from scripts.studies.open_world import (
    ABSENT,
    ANOTHER,
    lone_name,
    lone_names,
    outcome,
    plot_reliability,
    prediction,
    show,
    stated,
    statements,
)

Row = dict[str, Any]


def cause(name: str, probability: float, unknown: float | None = None, **others: float) -> Row:
    found = {
        "name": name,
        "probability": probability,
        "alternatives": [{"name": n, "probability": p} for n, p in others.items()],
    }
    return found if unknown is None else found | {"p_not_in_library": unknown}


def row(truth: str, verdict: str, *causes: Row, is_known: bool = True, unknown: float | None = None) -> Row:
    return {
        "kind": "open",
        "seed": 1,
        "protocol": "paper",
        "truth": [{"label": truth, "name": truth, "is_known": is_known}],
        "noise_T": {"hall.noise_T": 1e-5},
        "verdict": verdict,
        "causes": list(causes),
        "correction": None,
        "gain": {"before": {"vector_T": 3e-5}, "after": {"vector_T": 2e-5}},
        "p_not_in_library": unknown,
        "seconds": 1.0,
        "left_of_truth": 7.0,
    }


def test_probabilities_of_places_are_added_and_a_missing_unknown_is_none():
    two_places = cause("axis_gain[hall]", 0.6, **{"axis_gain[other]": 0.3, "cross_axis[hall]": 0.1})
    assert stated(two_places) == pytest.approx({"axis_gain": 0.9, "cross_axis": 0.1, ABSENT: 0.0})


def test_a_name_is_alone_only_without_alternatives_and_without_the_unknown():
    assert lone_name(cause("backlash", 1.0)) == "backlash"
    assert lone_name(cause("backlash", 0.7, robot_scale=0.3)) is None
    assert lone_name(cause("backlash", 0.97, unknown=0.03)) == "backlash"
    assert lone_name(cause("backlash", 0.8, unknown=0.2)) is None


def test_lone_names_are_right_relatives_or_wrong():
    found = row("overshoot", "named", cause("position_lag", 1.0), cause("axis_gain", 1.0), is_known=False)
    assert lone_names(found) == ([], ["position_lag"], ["axis_gain"])
    assert lone_names(row("axis_gain", "named", cause("axis_gain[hall]", 1.0))) == (["axis_gain"], [], [])


@pytest.mark.parametrize(
    ("found", "expected", "truth"),
    [
        (
            row("backlash", "named", cause("backlash", 0.9, 0.1)),
            {"backlash": 0.9, ABSENT: 0.1, ANOTHER: 0.0},
            "backlash",
        ),
        (
            row("backlash", "named", cause("axis_gain", 0.7)),
            {"axis_gain": 0.7, ABSENT: 0.0, ANOTHER: 0.3},
            ANOTHER,
        ),
        (row("tram_walk", "unexplained", is_known=False), {ABSENT: 1.0, ANOTHER: 0.0}, ABSENT),
        (row("tram_walk", "unexplained", is_known=False, unknown=0.8), {ABSENT: 0.8, ANOTHER: 0.2}, ABSENT),
    ],
)
def test_a_prediction_is_a_distribution_and_one_of_it_is_true(found, expected, truth):
    named = prediction(found)
    assert named == pytest.approx(expected)
    assert named is not None
    assert sum(named.values()) == pytest.approx(1.0)
    assert outcome(found, named) == truth


def test_the_summary_counts_verdicts_and_scores(capsys):
    rows = [
        row("backlash", "named", cause("backlash", 0.5, robot_scale=0.5)),
        row("tram_walk", "named", cause("axis_gain", 1.0), is_known=False),
        row("backlash", "nothing_found"),
    ]
    assert [tuple(one) for one in statements(rows)] == [(0.5, True), (0.5, False), (1.0, False)]
    show(rows)
    printed = capsys.readouterr().out
    assert "lone wrong name      33.3% (1 of 3), 95 % interval 0.8% to 90.6%" in printed
    assert "of these a name that readings could refute 33.3% (1 of 3)" in printed
    assert "at least 95%, mean 100.0%: 0.0% (0 of 1)" in printed
    assert "something was said in 66.7% (2 of 3); 33.3% (1 of 3) hold a cause outside the library" in printed
    log, brier = (0.6931 + 6.9078) / 2.0, (0.5 + 2.0) / 2.0  # a half; certain and wrong
    assert f"log {log:.3f} nats, Brier {brier:.3f}" in printed
    assert "error on unseen readings over the noise, median: 1.73 before, 1.15 after" in printed
    points = [line for line in plot_reliability(statements(rows)).lines if line.get_marker() == "o"]
    assert [(p.get_xdata()[0], p.get_ydata()[0]) for p in points] == [(0.5, 0.5), (1.0, 0.0)]


def test_a_twin_of_the_truth_is_no_name_that_readings_could_refute(capsys):
    show([row("tram_walk", "named", cause("axis_gain", 1.0), is_known=False) | {"left_of_truth": 4.9}])
    printed = capsys.readouterr().out
    assert "named, not the truth 100.0% (1 of 1)" in printed
    assert "of these a name that readings could refute 0.0% (0 of 1)" in printed


def test_a_cause_left_out_comes_back_in_its_place_even_after_a_failure():
    names, order = list(EFFECTS), dict(ORDER)

    def fails_without_it() -> None:
        with without("axis_gain"):
            assert "axis_gain" not in EFFECTS
            assert "axis_gain" not in ORDER
            raise RuntimeError("fails")

    with pytest.raises(RuntimeError, match="fails"):
        fails_without_it()
    assert list(EFFECTS) == names
    assert order == ORDER


def test_twins_are_no_wrong_names_and_a_set_may_hold_the_unknown():
    found = row("axis_gain", "named", cause("element_displacement", 1.0)) | {
        "left_beside": {"element_displacement": 2.9}
    }
    assert (mark(found), wrong_names(found), says_unknown(found)) == ("near twin", [], False)
    apart = row("axis_gain", "named", cause("backlash", 0.9, 0.1)) | {"left_beside": {"cross_axis": 9.0}}
    assert (mark(apart), wrong_names(apart), says_unknown(apart)) == ("", [], True)
    alone = row("axis_gain", "named", cause("backlash", 1.0)) | {"left_beside": {"cross_axis": 0.2}}
    assert (mark(alone), wrong_names(alone)) == ("exact twin", ["backlash"])
