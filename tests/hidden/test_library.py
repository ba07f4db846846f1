"""Lists of causes: which a study draws among, which are hidden by name only, and the links of each."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.effects import EFFECTS
from tests.hidden.causes import everyday, unforeseen
from tests.hidden.flaw import Stage
from tests.hidden.library import ALL, CAUSES, EVERYDAY, FIRST, LATER, OUTSIDE, UNFORESEEN, names, patterns
from tests.hidden.links import (
    LINK,
    LINK_OF_DEPARTURE,
    LINK_OF_LISTED,
    LINKS,
    LISTED,
    UNLISTED,
    WITH_ONE_SENSOR,
    links_of,
)
from tests.hidden.open_session import adjustable_of, draw_open_session, within
from tests.hidden.protocols import PROTOCOLS
from tests.hidden.study import OPEN_KINDS, RELATIVES, draw_case


def test_the_first_study_knows_its_own_causes_only():
    for protocol in PROTOCOLS:
        assert set(names(protocol, is_known=False)) == set(OUTSIDE)
        assert set(names(protocol)) <= set(FIRST)


def test_causes_that_came_later_are_hidden_by_name_only():
    assert not set(LATER) & set(CAUSES)
    possible = patterns("recommended", "displacement")
    assert {cause.name for cause in LATER.values() if cause.has_size} <= set(possible)
    assert not set(LATER) & set(within(ALL, is_known=True)(possible) + within((), is_known=False)(possible))
    hidden = draw_open_session([1], lambda names_of: [n for n in names_of if n in LATER], 12.0, 0)
    assert hidden.flaws[0].cause.name in LATER


def test_a_session_hides_them_only_by_name_and_old_lists_know_none():
    assert set(EVERYDAY) <= set(LATER)
    assert not set(EVERYDAY) & {*CAUSES, *OUTSIDE, *UNFORESEEN, *EFFECTS}
    assert set(EVERYDAY) <= set(RELATIVES)
    assert {name for truth in EVERYDAY for name in RELATIVES[truth]} <= set(EFFECTS)


def test_every_cause_with_a_size_has_links_and_a_list_that_holds_it_or_none():
    assert set(LISTED) | set(UNLISTED) == {cause.name for cause in ALL.values() if cause.has_size}
    assert set(LISTED) <= set(EFFECTS)
    assert not set(UNLISTED) & set(EFFECTS)
    for table in (LINK, LINK_OF_LISTED, WITH_ONE_SENSOR):
        assert {link for links in table.values() for link in links} <= set(LINKS)
    assert set(LINK_OF_DEPARTURE.values()) <= set(LINKS)
    assert set(LINK_OF_DEPARTURE) <= set(EFFECTS)
    assert {link for name in EVERYDAY for link in LINK[name]} == set(LINKS)
    assert links_of("warmup_gain", 2) == ("response",)
    assert links_of("warmup_gain", 1) == ("response", "current")
    assert links_of("nothing", 1) == ()
    for name, links in WITH_ONE_SENSOR.items():
        assert not set(links) & set(links_of(name, 2))
        assert links_of(name, 2)


def test_stages_are_those_of_the_links():
    assert {cause.name for cause in everyday.CAUSES if cause.stage == Stage.SENSOR} == {
        name for name in EVERYDAY if {"response", "zero"} & set(LINK[name])
    }


@pytest.mark.parametrize("cause", unforeseen.CAUSES, ids=lambda cause: cause.name)
@pytest.mark.parametrize("sigma", [12.0, 30.0])
def test_every_one_becomes_as_visible_as_is_asked_for(cause, sigma):
    hidden = draw_open_session([29], within({cause.name}, is_known=True), sigma, 1)
    assert hidden.flaws[0].cause is cause
    assert 0.0 < hidden.flaws[0].size <= cause.largest
    assert hidden.visible[0].sigma == pytest.approx(sigma, rel=5e-3)
    assert hidden.rig is not None
    again = adjustable_of(hidden.rig, hidden.scene).visible_sigma(hidden.flaws)
    assert again == pytest.approx(hidden.visible[0].sigma)


def test_there_are_eight_at_the_end_of_the_list_and_kinds_that_hold_only_them():
    assert tuple(CAUSES)[-8:] == UNFORESEEN
    assert OPEN_KINDS[-2:] == ("unforeseen30", "unforeseen12")
    assert not {name for truth in UNFORESEEN for name in RELATIVES.get(truth, ())} - set(EFFECTS)
    one, learnt = (draw_case("unforeseen12", 3, library) for library in ((), UNFORESEEN))
    np.testing.assert_array_equal(one.record.field_T, learnt.record.field_T)
    assert one.flaws[0].cause.name in UNFORESEEN
