"""Mixed sessions hold what they say: each flaw at its visible size beside the others, all from the seed alone, and older seeds as before."""

from __future__ import annotations

import numpy as np
import pytest

from tests.hidden import mixed_session
from tests.hidden.flaw import Flaw
from tests.hidden.handed_in import HiddenSession
from tests.hidden.library import ALL
from tests.hidden.links import LISTED, UNDER_ANOTHER_NAME, UNLISTED, WITH_ONE_SENSOR_NEARLY
from tests.hidden.mixed_session import (
    PRESENT,
    TWO_SENSORS,
    Mixture,
    beside_sigma,
    draw_mixture,
    flaws_of,
    in_order,
    of_first_sensor,
    possible,
    visible_of,
)
from tests.hidden.open_session import adjustable_of
from tests.hidden.study import MIXED_KINDS, draw_case
from tests.hidden.visible_size import effect_T

SEEDS = (14, 4, 5)  # a pair and two sensors; one cause and two sensors; a pair and one sensor


@pytest.fixture(scope="module")
def drawn() -> dict[int, HiddenSession]:
    return {seed: draw_case("mixed", seed) for seed in SEEDS}


CASES = [*((seed, "mixed") for seed in SEEDS), (SEEDS[0], "mixed_two")]


@pytest.mark.parametrize(("seed", "kind"), CASES)
def test_every_flaw_has_its_visible_size_alone_and_beside_the_others(seed, kind, drawn):
    hidden = drawn[seed] if kind == "mixed" else draw_case(kind, seed)
    number = MIXED_KINDS.index(kind)
    mixture = draw_mixture(np.random.default_rng([994, number, seed]), 1 + number)
    assert hidden.rig is not None
    adjustable = adjustable_of(hidden.rig, hidden.scene)
    sigmas = {flaw.cause.name: adjustable.visible_sigma([flaw]) for flaw in hidden.flaws}
    assert [visible.sigma for visible in hidden.visible] == pytest.approx(list(sigmas.values()))
    for sigma, beside in zip(sigmas.values(), beside_sigma(adjustable, hidden.flaws), strict=True):
        assert beside == pytest.approx(sigma, rel=PRESENT)
    for names, wanted in ((UNLISTED, mixture.unlisted_sigma), (LISTED, mixture.listed_sigma)):
        own = sorted(sigma for name, sigma in sigmas.items() if name in names)
        assert own == pytest.approx(sorted(wanted), rel=5e-3)
    assert len(mixture.unlisted_sigma) == 1 + number


def test_one_sensor_takes_all_readings_and_has_no_flaw_of_two(sessions):
    two = sessions["displacement", "recommended"][1]
    one = of_first_sensor(two)
    assert len(one.schedule.sensors) == len(one.noise_T) == 1
    own = two.schedule.sensor == 0
    np.testing.assert_allclose(
        one.measured().readings_T[own], two.measured().readings_T[own], rtol=1e-9, atol=1e-15
    )
    assert set(possible(two, LISTED)) - set(possible(one, LISTED)) == set(TWO_SENSORS)
    assert set(UNLISTED) - set(possible(two, UNLISTED)) == set(UNDER_ANOTHER_NAME)
    assert set(possible(two, UNLISTED)) - set(possible(one, UNLISTED)) == {"tool_left"}


@pytest.mark.parametrize(
    ("first", "second"),
    [("coil_ovality", "axial_pitch"), ("lead_wire", "turns_gradient"), ("axis_gain", "sensor_lag")],
)
def test_a_flaw_that_replaces_what_was_there_acts_first(first, second, sessions):
    scene = sessions["displacement", "recommended"][1]
    flaws = [Flaw(ALL[name], 0.05 * ALL[name].largest, 3) for name in (first, second)]
    alone = [effect_T(scene, [flaw]) for flaw in flaws]
    together, undone = effect_T(scene, in_order(flaws)), effect_T(scene, flaws)
    least = min(np.linalg.norm(one) for one in alone)
    assert np.linalg.norm(together - sum(alone)) < 0.1 * least
    assert np.linalg.norm(undone - sum(alone)) > 0.5 * np.linalg.norm(alone[0])


def test_one_sensor_hides_no_unlisted_cause_that_is_nearly_a_listed_one(sessions, monkeypatch):
    rig, scene = sessions["displacement", "recommended"]
    mixture = Mixture(False, True, (), (6.0,))
    for name in WITH_ONE_SENSOR_NEARLY:
        monkeypatch.setattr(mixed_session, "UNLISTED", (name,))
        for session, is_void in ((scene, False), (of_first_sensor(scene), True)):
            flaws = flaws_of(adjustable_of(rig, session), mixture, np.random.default_rng(0))
            assert (flaws == ()) == is_void


def test_a_mixture_counts_where_each_flaw_is_there_and_none_is_anothers_twin(sessions):
    rig, scene = sessions["displacement", "recommended"]
    two, one = adjustable_of(rig, scene), adjustable_of(rig, of_first_sensor(scene))
    replaced = [Flaw(ALL[name], 0.1 * ALL[name].largest, 3) for name in ("axis_gain", "sensor_lag")]
    twins = [Flaw(ALL[name], ALL[name].largest, 3) for name in ("background_field", "sensor_offset")]
    assert visible_of(two, replaced) == ()  # the second takes the place of the first
    assert visible_of(one, twins) == ()  # the same to every reading of one sensor
    mixture = in_order(replaced)
    visible = visible_of(two, mixture)
    assert [size.sigma for size in visible] == pytest.approx([two.visible_sigma([f]) for f in mixture])
    for size in visible:
        assert size.unlike_sigma is not None
        assert 3.0 <= size.unlike_sigma <= size.sigma
