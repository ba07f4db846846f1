"""Every cause and every departure acts at one link of the chain."""

from __future__ import annotations

from estimator.diagnosis.mixture.links import Link, link_of
from estimator.effects import EFFECTS
from estimator.effects.stages import NoiseEffect
from tests.hidden.links import LINK_OF_LISTED


def test_only_mistakes_of_the_record_and_noise_act_at_no_other_link():
    for effect in EFFECTS.values():
        is_of_record = effect.is_record_mistake or isinstance(effect, NoiseEffect)
        assert is_of_record or link_of(effect) is not Link.RECORD, effect.name
        assert link_of(effect).words


def test_links_are_those_that_somebody_else_has_said():
    told = {name: links for name, links in LINK_OF_LISTED.items() if name in EFFECTS}
    assert len(told) > 30
    assert {n: link_of(EFFECTS[n]).value for n in told if link_of(EFFECTS[n]).value not in told[n]} == {}
