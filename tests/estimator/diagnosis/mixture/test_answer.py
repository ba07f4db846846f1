"""What is read off draws: sets of alternatives, what is stated, and links at which something unlisted acts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from estimator.diagnosis.mixture import answer as answers
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.mixture.asked import Asked
from estimator.diagnosis.mixture.imitation import AT_ITS_LINK, AT_OWN_LINK
from estimator.diagnosis.mixture.links import Link
from estimator.diagnosis.mixture.slots import Samples
from tests.estimator.diagnosis.mixture.dictionaries import dictionary, item

GAIN, TWIN, WANDERS, FAINT = range(4)
ITEMS = (item("gain", [0]), item("twin", [1]), item("wanders", [2], is_listed=False), item("faint", [3]))


def samples(models: dict[tuple[int, ...], int], shares: dict[int, dict[int, float]]) -> Samples:
    """Draws of models, in which the slot of an item holds others with some shares."""
    made = Samples(len(ITEMS))
    made.n = sum(models.values())
    for model, n in models.items():
        made.models[model] += n
        made.conditional[list(model)] += n
    for drawn, conditional in shares.items():
        made.beside[drawn] = np.array([conditional.get(i, 0.0) for i in range(len(ITEMS))])
    return made


def answered(
    with_all: Samples,
    *in_halves: Samples,
    n_slots: int = 6,
    expected: dict[int, float] | None = None,
    evidence: float = 1e4,
) -> Answer:
    """An answer with these draws, in which each item has the same log Bayes factor."""
    leading = max(with_all.models, key=with_all.models.__getitem__)
    with_all.noises[0] = 1
    asked = object.__new__(Asked)
    more = SimpleNamespace(
        conditional=lambda chosen, noise: np.array([0.9, 0.1])
    )  # one more item is probable
    products = SimpleNamespace(gains=lambda chosen, noise: dict.fromkeys(chosen, evidence))
    grid = torch.ones(1)
    slots = SimpleNamespace(n_slots=n_slots, conditional=more.conditional, products=products, grid=grid)
    asked.__dict__.update(dictionary=dictionary(ITEMS), samples=with_all, leading=leading, slots=slots)
    pool = [SimpleNamespace(cause=one.cause) for one in ITEMS]
    asked.__dict__.update(pool=pool, expansion=SimpleNamespace(causes=()))
    return Answer(asked, asked, in_halves, expected or {})


@pytest.fixture(autouse=True)
def _nothing_like_a_cause_is_left(monkeypatch):
    monkeypatch.setattr(answers, "evidence_of_relatives", lambda asked, item: 0.0)


BOTH = {
    GAIN: {GAIN: 80.0, TWIN: 20.0},
    TWIN: {GAIN: 80.0, TWIN: 20.0},
    WANDERS: {WANDERS: 1.0},
    FAINT: {FAINT: 1.0},
}
TWIN_CAUSE = ITEMS[TWIN].cause
MODELS = {(GAIN, WANDERS): 78, (TWIN, WANDERS): 20, (GAIN,): 2}


def test_what_takes_the_same_slot_is_one_set_and_as_sure_as_both_together():
    (first, second) = answered(samples(MODELS, BOTH)).found
    assert [(one.cause.name, round(one.share, 1)) for one in first.possibilities] == [
        ("gain", 0.8),
        ("twin", 0.2),
    ]
    assert (first.probability, second.probability) == pytest.approx((1.0, 0.98))
    assert second.first.link is Link.RESPONSE


def test_what_halves_have_less_than_half_as_often_as_expected_is_not_stated():
    halves = samples({(WANDERS,): 60, (GAIN, WANDERS): 40}, BOTH)
    made = answered(samples(MODELS, BOTH), halves, expected={GAIN: 0.9})
    (gain,) = [one for one in made.found if one.first.is_listed]
    assert (gain.with_all, gain.in_halves) == pytest.approx((1.0, 0.4))
    assert gain.probability == pytest.approx(2.0 * 0.4 / 0.9)
    assert made.stated == ()
    assert gain in made.beside


@pytest.mark.parametrize(("relative", "is_doubtful"), [(0.0, False), (9.0, True)])
def test_a_name_may_be_an_imitation_where_something_like_it_is_left(relative, is_doubtful, monkeypatch):
    monkeypatch.setattr(answers, "evidence_of_relatives", lambda asked, item: relative)
    every = samples(MODELS, BOTH)
    made = answered(every, every, expected={GAIN: 0.99})
    (gain,) = (one for one in made.found if one.first.is_listed)
    assert gain.probability == pytest.approx(1.0)
    imitation = made.standing(gain.first.cause, [gain.first.cause, TWIN_CAUSE]).p_imitation
    assert sum(one.share for one in gain.possibilities) == pytest.approx(1.0 - imitation)
    assert (imitation > 0.2) == is_doubtful


def test_an_imitation_acts_at_the_link_of_what_it_resembles_as_often_as_was_counted(monkeypatch):
    monkeypatch.setattr(answers.Standing, "p_imitation", 0.4)
    (gain,) = (one for one in answered(samples(MODELS, BOTH)).found if one.first.is_listed)
    assert gain.family.links == (gain.first.link,)
    assert gain.family.probability == pytest.approx(0.6 + AT_ITS_LINK * 0.4)


def test_halves_say_nothing_against_a_cause_where_nothing_unlisted_acts():
    """A half may be too small to show it."""
    halves = samples({(): 60, (GAIN,): 40}, BOTH)
    made = answered(samples({(GAIN,): 96, (): 4}, BOTH), halves, expected={GAIN: 0.3})
    (gain,) = made.stated
    assert (gain.probability, gain.in_halves) == pytest.approx((0.96, 0.4))
    assert made.p_unlisted == 0.0
    assert not made.leaves_something


def test_a_departure_is_never_stated_as_a_cause_but_told_with_its_link():
    made = answered(samples(MODELS, BOTH))
    assert [one.first.cause.name for one in made.stated] == ["gain"]
    assert [one.first.cause.name for one in made.beside] == ["wanders"]
    assert made.unlisted == pytest.approx({Link.RESPONSE: 0.98 * AT_OWN_LINK})


def test_a_stated_cause_leads_in_the_place_of_a_departure_in_its_slot(monkeypatch):
    """Full fits are asked about it by readings that still have what it does."""
    slot = {GAIN: 60.0, WANDERS: 40.0}
    drawn = samples({(WANDERS, FAINT): 60, (GAIN, FAINT): 40}, {**BOTH, GAIN: slot, WANDERS: slot})
    monkeypatch.setattr(answers.Standing, "p_imitation", 0.0)
    made = answered(drawn)
    assert made.asked.leading == (WANDERS, FAINT)
    assert made.leading_as_stated == (GAIN, FAINT)


@pytest.mark.parametrize("further", [20.0, 60.0])
def test_where_all_slots_are_full_a_cause_must_outweigh_what_any_further_item_could_explain(
    further, monkeypatch
):
    made = answered(samples(MODELS, BOTH), n_slots=2)
    made.asked.slots.evidence = lambda chosen, noise: torch.tensor([0.0, further])
    comparison = SimpleNamespace(log_bayes_factor=lambda causes: 100.0)
    monkeypatch.setattr(Answer, "in_place_of", lambda self, entry: comparison)
    assert made.is_full
    assert len(made.stated) == (further < 50.0)


def test_probabilities_of_a_set_add_up_in_its_record_but_for_imitations(monkeypatch):
    monkeypatch.setattr(answers.Standing, "p_imitation", 0.0)
    record = answered(samples(MODELS, BOTH)).to_json()
    for one in record["found"]:
        departs = not one["is_one_of"][0]["is_listed"]
        whole = one["probability"] * (AT_OWN_LINK if departs else 1.0)
        assert sum(each["probability"] for each in one["is_one_of"]) == pytest.approx(whole)
    assert record["unlisted"] == pytest.approx({"response": 0.98 * AT_OWN_LINK})
