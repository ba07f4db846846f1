"""Sessions of the open world are right before they may judge others: arms, rigs, kinds of sessions, visible sizes and rivals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.hidden.flaw import Flaw
from tests.hidden.library import CAUSES
from tests.hidden.open_session import adjustable_of, draw_open_session, within
from tests.hidden.protocols import MOTIONS, PROTOCOLS, draw_schedule
from tests.hidden.rivals import left_beside, rival_of
from tests.hidden.session import CLEARANCE_M, clearance_m
from tests.hidden.stated_rig import WIDE_WINDING_SD, draw_rig
from tests.hidden.study import KINDS, OPEN_KINDS
from tests.hidden.ur_arm import flange_pose
from tests.hidden.visible_size import Adjustable


def test_an_arm_that_does_not_come_everywhere_is_set_up_anew():
    rng = np.random.default_rng([993, 0, 103])
    rig, schedule = draw_rig(draw_schedule(PROTOCOLS[int(rng.integers(2))], rng), rng)
    assert schedule.joint_rad is not None
    np.testing.assert_allclose(flange_pose(rig.motion, schedule.joint_rad)[1], schedule.displacement_m)


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_readings_keep_clear_of_the_winding_where_it_is_and_where_the_file_says(motion, protocol, sessions):
    rig, scene = sessions[motion, protocol]
    assert clearance_m(scene) > CLEARANCE_M
    if scene.turn is not None and rig.base_rotation is not None and rig.base_position_m is not None:
        stated = scene.turn @ np.array([0.0, 0.0, 0.07]) + scene.schedule.displacement_m
        face_m = stated @ rig.base_rotation.T + rig.base_position_m
        normal = (rig.base_rotation @ scene.turn)[:, :, 2]
        above_m = np.einsum("ni,ni->n", scene.sensor_position_m - face_m, normal)
        assert above_m.min() > CLEARANCE_M
        angle_rad = Rotation.from_matrix(scene.turn[:1].swapaxes(1, 2) @ scene.turn).magnitude()
        assert np.rad2deg(angle_rad.max()) > 5.0


def test_tight_priors_make_visible_what_wide_ones_absorb(sessions):
    rig, scene = sessions["displacement", "paper"]
    flaw = [Flaw(CAUSES["current_gain"], 0.03, 0)]
    wide = Adjustable.of(
        scene, {n: 10.0 * WIDE_WINDING_SD.get(n, sd) for n, sd in rig.prior_sd.items()}, has_priors=True
    )
    tight = Adjustable.of(scene, {n: 1e-3 * abs(rig.mean(n)) + 1e-9 for n in rig.prior_sd}, has_priors=True)
    assert wide.visible_sigma(flaw) < 0.1
    assert tight.visible_sigma(flaw) > 5.0


def test_what_is_unknown_depends_on_the_library_alone():
    assert within({"a"}, is_known=True)(["a", "b"]) == ["a"]
    assert within({"a"}, is_known=False)(["a", "b"]) == ["b"]
    with pytest.raises(ValueError, match="no cause that was asked for reaches 8 sigma"):
        draw_open_session([1], lambda _: [], 8.0, 0)
    assert not set(KINDS) & set(OPEN_KINDS)


def test_an_exact_twin_leaves_nothing_and_itself_is_no_twin(sessions):
    rig, scene = sessions["displacement", "paper"]
    library = (
        "background_field",
        "sensor_offset",
        "robot_scale",
        "iron_core",
        "mains_hum",
        "current_remanence",
    )
    left = left_beside(adjustable_of(rig, scene), Flaw(CAUSES["background_field"], 5e-5, 3), library)
    assert next(iter(left)) == "sensor_offset"
    assert set(left) == {"sensor_offset", "robot_scale", "iron_core"}
    assert left["sensor_offset"] < 1e-6
    assert left["robot_scale"] > 3.0


def test_a_library_that_moves_every_element_imitates_a_gain(sessions):
    """The hidden cause leaves the x element in place; fitted broadly it is nearer to a gain of x."""
    rig, scene = sessions["displacement", "recommended"]
    here = adjustable_of(rig, scene)
    gain = replace(
        CAUSES["axis_gain"], apply=lambda s, size, _: CAUSES["axis_gain"].apply(s, size, _of_axis(0))
    )
    flaw = Flaw(gain, 0.02, 0)
    broad = left_beside(here, flaw, ("element_displacement",))["element_displacement"]
    narrow = rival_of(here, CAUSES["element_displacement"]).left_over(here.left_over([flaw]))
    assert broad < 0.8 * narrow


def _of_axis(wanted: int) -> np.random.Generator:
    """A generator that first draws the first of two sensors, then this axis."""

    def draws(seed: int) -> tuple[int, int]:
        rng = np.random.default_rng(seed)
        return int(rng.integers(2)), int(rng.integers(3))

    return np.random.default_rng(next(seed for seed in range(100) if draws(seed) == (0, wanted)))
