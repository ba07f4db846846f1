from __future__ import annotations

import numpy as np
import pytest

from estimator.reporting.numbers import Display, displays, summary, with_sd

POSES = ["coil1.world_from_coil0.x_m", "coil1.flange_from_coil.x_m", "coil2.flange_from_coil.x_m"]


@pytest.mark.parametrize(
    ("name", "unit", "factor"),
    [
        ("c.radius_m", "mm", 1e3),
        ("c.spin_rad", "mrad", 1e3),
        ("s.noise_T", "µT", 1e6),
        ("iron_body[room].volume_m3", "cm³", 1e6),
        ("e.tau_h", "s", 3600.0),
        ("c.gain", "", 1.0),
    ],
)
def test_the_suffix_of_a_name_sets_the_unit_shown(name, unit, factor):
    display = displays([name])[name]
    assert (display.unit, display.factor) == (unit, pytest.approx(factor))


def test_words_stay_distinct_when_bodies_and_blocks_share_a_quantity():
    words = [display.words for display in displays(POSES).values()]
    assert len(set(words)) == len(POSES)
    assert "world from coil0" in words[0]
    assert displays(POSES[:1])[POSES[0]].words == "x"


def test_a_dollar_in_a_name_is_not_read_as_a_formula():
    assert displays(["a$b$.gain", "c.gain"])["a$b$.gain"].words == r"a\$b\$ gain"


def test_values_are_cut_at_the_second_digit_of_their_sd():
    assert with_sd(50.98123, 0.0312) == "50.981 ± 0.031"
    assert with_sd(50.0, 0.09996) == "50.00 ± 0.10"
    assert with_sd(-0.2, 30.0) == "0 ± 30"
    assert with_sd(50.0, float("nan")) == "not known"


def test_counts_are_summed_up_by_the_most_probable_one():
    assert summary(np.array([48.0, 48.0, 48.0, 47.0]), Display("loops", "", 1.0)) == "48 (75 %)"
    assert summary(np.array([1.0, 3.0]), Display("x", "mm", 1e3)) == "2.0 ± 1.0 mm"
