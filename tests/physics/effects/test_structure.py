"""Hidden and reversed windings against explicit sums of magpylib's loops."""

from __future__ import annotations

import numpy as np
import pytest

from tests.physics.effects.laboratory import POINTS_M, Loops, added_T, assert_same_field, readings, winding

ONE = readings(POINTS_M, (1.0, 0.0))


@pytest.mark.parametrize("layer", [0, 1, 3])
def test_reversed_layer_is_the_winding_with_one_layer_in_the_other_sense(layer):
    loops = winding()
    in_layer = np.isclose(loops.radius_m, 0.04 - 1e-3 * (layer + 0.5))
    assert in_layer.sum() == 6
    turned = Loops(loops.radius_m[in_layer], loops.height_m[in_layer], np.full(6, -2.0))
    effect = {"reversed_layer[coil]": {"share": 1.0, "depth": layer / 3.0}}
    assert_same_field(added_T(ONE, effect), turned.field_T(POINTS_M), 1e-6)


@pytest.mark.parametrize(
    ("turns", "radius", "middle", "length"), [(-0.2, 1.3, -0.4, 0.3), (0.1, 0.5, -1.5, 0.8)]
)
def test_hidden_winding_is_a_sheet_of_loops_about_the_same_axis(turns, radius, middle, length):
    """Its turns are shares of the coil's 24, its lengths of the coil's 40 mm; the code takes six loops for it."""
    n = 400
    heights_m = 0.04 * (middle + length * ((np.arange(n) + 0.5) / n - 0.5))
    sheet = Loops(np.full(n, 0.04 * radius), heights_m, np.full(n, 24.0 * turns / n))
    given = {"turns": turns, "radius": radius, "middle": middle, "length": length}
    assert_same_field(added_T(ONE, {"hidden_winding[coil]": given}), sheet.field_T(POINTS_M), 2e-3)
