"""What the study of mixed sessions counts, on rows that were made up: causes stated, names that are not there, intervals and links."""

from __future__ import annotations

from typing import Any

import pytest

from scripts.studies.mixed_counts import (
    Judged,
    coil_inside,
    is_stated,
    is_stated_alone,
    is_taken,
    judged,
    link_told,
    p_of_its_links,
    p_unlisted,
    probabilities,
    sizes_inside,
    tells_of_unlisted,
)

Row = dict[str, Any]


def cause(name: str, probability: float, unknown: float = 0.0, **others: float) -> Row:
    return {
        "name": name,
        "place": "hall",
        "probability": probability,
        "p_not_in_library": unknown,
        "alternatives": [{"name": n, "probability": p} for n, p in others.items()],
        "parameters": {},
    }


def truth(name: str, sigma: float, *links: str, place: str = "hall", **quantities: float) -> Row:
    return {
        "name": name,
        "label": name,
        "place": place,
        "visible_sigma": sigma,
        "is_listed": not links,
        "links": list(links),
        "parameters": {key: {"value": value, "unit": "1"} for key, value in quantities.items()},
    }


def row(*causes: Row, hidden: tuple[Row, ...] = (), **others: Any) -> Row:
    unlisted = truth("compressor_dips", 12.0, "current", "response")
    return {
        "kind": "mixed",
        "seed": 1,
        "verdict": "named",
        "causes": list(causes),
        "truth": [*(hidden or (truth("cable_pull", 10.0),)), unlisted],
        "sensors": ["hall", "other"],
        "noise_T": {"hall.noise_T": 1e-5},
        "gain": {"before": {"vector_T": 4e-5}, "after": {"vector_T": 1.8e-5}},
        "correction": None,
        "p_not_in_library": 0.2,
        "links": None,
        "coil": {},
        "told": {"stand_ins": []},
        "seconds": 3.0,
    } | others


def test_a_cause_is_stated_alone_or_in_a_set_that_leaves_little_to_the_unlisted():
    gain = truth("axis_gain", 20.0)
    alone = row(cause("axis_gain[hall]", 0.95, 0.05), hidden=(gain,))
    assert is_stated_alone(alone, gain)
    in_a_set = row(cause("cross_axis", 0.6, 0.05, **{"axis_gain[hall]": 0.35}), hidden=(gain,))
    assert not is_stated_alone(in_a_set, gain)
    assert is_stated(in_a_set, gain)
    doubted = row(cause("axis_gain", 0.85, 0.15), hidden=(gain,))
    assert not is_stated(doubted, gain)
    assert judged(doubted) == Judged(0, 0, 0, 0)
    assert judged(doubted, 0.0) == Judged(1, 0, 0, 0)


def test_a_cause_that_stands_in_unnamed_is_taken_and_not_stated():
    gain = truth("axis_gain", 20.0)
    unnamed = row(hidden=(gain,), told={"stand_ins": [cause("axis_gain[hall]", 1.0)]})
    assert is_taken(unnamed, gain)
    assert not is_stated(unnamed, gain)
    assert not is_taken(unnamed, truth("backlash", 9.0))
    assert is_taken(row(cause("cross_axis", 0.4, 0.4, axis_gain=0.2)), gain)


def test_a_relative_of_a_listed_cause_is_no_wrong_name_and_one_of_the_unlisted_is():
    pair = (truth("joint_zeros", 20.0), truth("axis_gain", 9.0))
    statements = row(
        cause("base_misplaced", 0.99),  # a relative of joint_zeros
        cause("current_step", 0.97),  # a relative of compressor_dips, which is not listed
        cause("backlash", 0.5, robot_scale=0.45),  # nothing to do with any
        cause("axis_gain[other]", 1.0),
        cause("planar_hall", 0.3, 0.7),  # not stated
        hidden=pair,
    )
    assert judged(statements) == Judged(1, 1, 2, 1)


def test_probabilities_are_right_of_listed_causes_only():
    stated = row(
        cause("axis_gain[hall]", 0.6, 0.1, **{"axis_gain[other]": 0.2, "compressor_dips": 0.1}),
        hidden=(truth("axis_gain", 9.0),),
    )
    assert [tuple(one) for one in probabilities(stated)] == [(pytest.approx(0.8), True), (0.1, False)]


def test_true_sizes_are_looked_for_at_their_own_sensor():
    offset = truth("sensor_offset", 20.0, place="other", offset_x_T=1e-4, offset_y_T=0.0, offset_z_T=2e-4)
    interval = {"x_T": {"ci90": [0.5e-4, 1.5e-4]}, "z_T": {"ci90": [0.5e-4, 1.5e-4]}}
    right = cause("sensor_offset[other]", 1.0) | {"place": "other", "parameters": interval}
    elsewhere = cause("sensor_offset[hall]", 1.0) | {"parameters": interval}
    assert sizes_inside(row(right, elsewhere, hidden=(offset,))) == [True, False]
    assert sizes_inside(row(elsewhere, hidden=(offset,))) == []


def test_numbers_of_the_coil_are_counted_by_model_unless_a_cause_redefines_them():
    number = {"truth": 1.0, "plain": [1.1, 1.2], "extended": [0.9, 0.99], "widened": [0.8, 1.1]}
    coil = {"coil1.radius_m": number}
    told = row(coil=coil)
    assert [coil_inside(told, model) for model in ("plain", "extended", "widened")] == [
        [False],
        [False],
        [True],
    ]
    assert coil_inside(row(hidden=(truth("winding_misstated", 9.0),), coil=coil), "widened") == []


def test_something_unlisted_is_told_by_verdict_or_probability():
    assert not tells_of_unlisted(row())
    assert tells_of_unlisted(row(p_not_in_library=0.5))
    assert tells_of_unlisted(row(verdict="unexplained"))
    assert p_unlisted(row(verdict="unexplained", p_not_in_library=None)) == 1.0
    assert p_unlisted(row(p_not_in_library=None)) == 0.0


def test_links_are_right_where_an_honest_physicist_would_accept_them():
    told = row(links={"current": 0.3, "response": 0.25, "room": 0.45})
    assert link_told(told) == "room"
    assert p_of_its_links(told) == pytest.approx(0.55)
    assert link_told(row()) is None
    assert p_of_its_links(row()) == 0.0
