"""Causes of mixed sessions do what their sentences say: a limit or a law each, nothing at no size, and twice as much at twice the size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from tests.hidden.causes import everyday
from tests.hidden.causes.everyday import strongest_so_far
from tests.hidden.conftest import Sessions
from tests.hidden.flaw import Cause, Flaw, Stage
from tests.hidden.library import ALL, CAUSES, EVERYDAY, LATER, OUTSIDE, UNFORESEEN
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
from tests.hidden.scene import Scene
from tests.hidden.stated_rig import MOUNT_M
from tests.hidden.study import RELATIVES
from tests.hidden.visible_size import effect_T


def applied(name: str, scene: Scene, size: float, seed: int = 3) -> tuple[Scene, dict[str, float]]:
    made, truth = ALL[name].apply(scene, size, np.random.default_rng(seed))
    return made, {p.name: p.value for p in truth.parameters}


def triple(known: dict[str, float], name: str, end: str = "") -> np.ndarray:
    return np.array([known[f"{name}_{axis}{end}"] for axis in "xyz"])


@pytest.fixture
def scene(sessions: Sessions) -> Scene:
    """Displacements, several currents, two sensors."""
    return sessions["displacement", "recommended"][1]


@pytest.fixture
def carried(sessions: Sessions) -> Scene:
    """One current, one sensor, and a flange whose poses are written down."""
    return sessions["pose", "paper"][1]


# ------------------------------------------------------------------------------- all of them


@pytest.mark.parametrize("cause", everyday.CAUSES, ids=lambda cause: cause.name)
def test_no_size_is_no_flaw_and_small_sizes_act_in_proportion(
    cause: Cause, scene: Scene, carried: Scene
) -> None:
    for session in (scene, carried):
        sizes = (0.0, 1e-3, 2e-3, 1.0)
        none, small, twice, whole = (effect_T(session, [Flaw(cause, s * cause.largest, 3)]) for s in sizes)
        assert np.abs(none).max() < 1e-15
        assert np.linalg.norm(twice - 2.0 * small) < 0.05 * np.linalg.norm(twice)
        assert np.linalg.norm(whole) > 100.0 * np.linalg.norm(small)


def test_a_session_hides_them_only_by_name_and_old_lists_know_none() -> None:
    assert set(EVERYDAY) <= set(LATER)
    assert not set(EVERYDAY) & {*CAUSES, *OUTSIDE, *UNFORESEEN, *EFFECTS}
    assert set(EVERYDAY) <= set(RELATIVES)
    assert {name for truth in EVERYDAY for name in RELATIVES[truth]} <= set(EFFECTS)


def test_every_cause_with_a_size_has_links_and_a_list_that_holds_it_or_none() -> None:
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


# ------------------------------------------------------------------------------- current and winding


def test_a_compressor_takes_the_same_share_for_a_part_of_each_period(scene: Scene) -> None:
    made, known = applied("compressor_dips", scene, 0.02)
    is_driven = scene.current_A != 0.0
    ratio = np.round(made.current_A[is_driven] / scene.current_A[is_driven], 12)
    assert set(ratio) == {1.0, 0.98}
    long = replace(scene.schedule, time_s=np.linspace(0.0, 1e5, len(scene.schedule)))
    made, known = applied("compressor_dips", replace(scene, schedule=long), 0.02)
    is_less = np.abs(made.current_A) < np.abs(scene.current_A)
    assert is_less[is_driven].mean() == pytest.approx(known["duty"], abs=0.12)


def test_a_bent_cable_takes_current_with_the_square_of_the_way(carried: Scene) -> None:
    made, known = applied("flexing_cable", carried, 0.04)
    way_m = carried.schedule.displacement_m @ triple(known, "along")
    share = (way_m - way_m.min()) / np.ptp(way_m)
    np.testing.assert_allclose(1.0 - made.current_A / carried.current_A, 0.04 * share**2, atol=1e-12)
    assert share.max() == 1.0


def test_a_cone_has_the_moment_of_its_loops_and_turns_over_with_its_sign(scene: Scene) -> None:
    w, far_m = scene.winding, np.array([[0.0, 0.0, 60.0]])
    made, known = applied("tapered_former", scene, 0.08)
    stretch = 1.0 + known["taper"] * (2.0 * w.heights_m / w.length_m + 1.0)
    ratio = made.coil_field(far_m)[0, 2] / scene.coil_field(far_m)[0, 2]
    assert ratio == pytest.approx((stretch**2).mean(), rel=3e-4)
    point_m = np.array([[0.0, 0.0, 0.03]])
    changes = {}
    for seed in range(8):
        made, known = applied("tapered_former", scene, 1e-4, seed)
        changes[np.sign(known["taper"])] = (made.coil_field(point_m) - scene.coil_field(point_m))[0, 2]
    assert changes[1.0] == pytest.approx(-changes[-1.0], rel=0.01)


def test_a_bridged_layer_is_gone_in_the_warm_and_there_in_the_cold(scene: Scene) -> None:
    w = scene.winding
    made, _ = applied("warm_short", scene, 0.5)
    far_m = np.broadcast_to([0.0, 0.0, 40.0], scene.sensor_position_m.shape)
    is_driven = scene.current_A != 0.0
    share = np.linalg.norm(made.sources[0](scene, far_m), axis=1)[is_driven]
    share /= np.linalg.norm(scene.coil_field_at(far_m), axis=1)[is_driven]
    expected = 0.5 * w.radii_m[-1] ** 2 / (w.radii_m**2).sum()
    is_bridged = share > 0.0
    np.testing.assert_allclose(share[is_bridged], expected, rtol=5e-3)
    warming = scene.schedule.coil_warming[is_driven]
    assert warming[is_bridged].min() > warming[~is_bridged].max()


# ------------------------------------------------------------------------------- room


def test_a_bolt_remembers_the_strongest_field_for_good(scene: Scene) -> None:
    np.testing.assert_array_equal(
        strongest_so_far(np.array([0.0, 1.0, -0.5, -2.0, 1.5, 3.0])), [0.0, 1.0, 1.0, -2.0, -2.0, 3.0]
    )
    made, known = applied("remembering_bolt", scene, 1e-5)
    shank = triple(known, "shank")
    beyond_m = np.broadcast_to(triple(known, "position", "_m") + 0.1 * shank, scene.sensor_position_m.shape)
    along_T = made.sources[0](scene, beyond_m) @ shank
    assert (np.diff(np.abs(along_T)) >= -1e-18).all()
    at_bolt_m = np.broadcast_to(triple(known, "position", "_m"), beyond_m.shape)
    strongest_T = np.abs(scene.coil_field_at(at_bolt_m) @ shank).max()
    assert np.abs(along_T[-1]) == pytest.approx(2e-5 / 0.1**3 * strongest_T)
    twice, _ = applied("remembering_bolt", scene, 2e-5)
    np.testing.assert_allclose(twice.sources[0](scene, beyond_m) @ shank, 2.0 * along_T)


def test_a_neighbours_field_rises_stays_and_falls(carried: Scene) -> None:
    made, known = applied("neighbour_ramp", carried, 1e-4)
    field_T = made.sources[0](carried, carried.sensor_position_m)
    share = np.linalg.norm(field_T, axis=1) / 1e-4
    since_s = carried.schedule.time_s - known["begin_s"]
    is_held = (since_s > known["ramp_s"]) & (since_s < known["whole_s"] - known["ramp_s"])
    np.testing.assert_allclose(share[is_held], 1.0)
    assert share[(since_s < 0.0) | (since_s > known["whole_s"])].max() == 0.0
    is_rising = (since_s > 0.0) & (since_s < known["ramp_s"])
    np.testing.assert_allclose(share[is_rising], since_s[is_rising] / known["ramp_s"])
    np.testing.assert_array_equal(made.sources[0](carried, carried.sensor_position_m + 1.0), field_T)


# ------------------------------------------------------------------------------- mover and mount


def test_lost_steps_add_up_and_a_move_back_loses_none(carried: Scene) -> None:
    made, known = applied("lost_steps", carried, 1e-4)
    along = triple(known, "along")
    lost = -(made.displacement_m - carried.displacement_m) @ along / 1e-4
    np.testing.assert_allclose(lost, np.round(lost), atol=1e-9)
    step, move_m = np.round(np.diff(lost)), np.diff(carried.schedule.displacement_m @ along)
    assert set(step) == {0.0, 1.0}
    assert step[move_m <= 0.0].max() == 0.0
    assert (step[move_m > 0.0] == 1.0).mean() == pytest.approx(0.4, abs=0.03)


def test_a_frame_breathes_about_where_it_began(carried: Scene) -> None:
    made, known = applied("frame_breathing", carried, 1e-3)
    way_m = carried.displacement_m - carried.displacement_m[0]
    phase = 2.0 * np.pi * carried.schedule.time_s / known["period_s"] + known["phase_rad"]
    error_m = made.displacement_m - carried.displacement_m
    np.testing.assert_allclose(error_m, 1e-3 * np.sin(phase)[:, None] * way_m, atol=1e-15)
    assert not error_m[0].any()


def test_a_warm_mount_tips_the_coil_with_its_warmth_and_leaves_the_flange(
    scene: Scene, carried: Scene
) -> None:
    for session in (scene, carried):
        made, _ = applied("warm_mount", session, 0.02)
        assert made.turn is not None
        before = np.broadcast_to(np.eye(3), made.turn.shape) if session.turn is None else session.turn
        angle_rad = Rotation.from_matrix(before.swapaxes(1, 2) @ made.turn).magnitude()
        np.testing.assert_allclose(angle_rad, 0.02 * session.schedule.coil_warming, atol=1e-7)
    made, _ = applied("warm_mount", scene, 0.02)
    flange_m = [
        one.coil_origin_m() - one.from_coil_axes(np.broadcast_to(MOUNT_M, one.displacement_m.shape))
        for one in (made, scene)
    ]
    np.testing.assert_allclose(flange_m[0], flange_m[1], atol=1e-15)


def test_a_loose_probe_stands_at_one_of_two_places_and_jumps_only_with_moves(scene: Scene) -> None:
    made, known = applied("toggling_probe", scene, 5e-4)
    shift_m = made.sensor_position_m - scene.sensor_position_m
    is_away = np.linalg.norm(shift_m, axis=1) > 0.0
    np.testing.assert_allclose(shift_m[is_away], np.tile(triple(known, "shift", "_m"), (is_away.sum(), 1)))
    sensors = {int(s) for s in scene.schedule.sensor[is_away]}
    assert len(sensors) == 1
    is_its = scene.schedule.sensor == sensors.pop()
    jumps = np.diff(is_away[is_its].astype(int)) != 0
    assert 4 <= jumps.sum() < 40
    stays = np.diff(scene.schedule.visit[is_its]) == 0
    assert not jumps[stays].any()


# ------------------------------------------------------------------------------- response and zero


def test_an_amplifier_settles_to_its_right_gain(carried: Scene) -> None:
    measured = carried.measured()
    made, known = applied("warmup_gain", measured, 0.01)
    gain = np.linalg.norm(made.readings_T, axis=1) / np.linalg.norm(measured.readings_T, axis=1)
    assert abs(gain[0] - 1.0) == pytest.approx(0.01)
    rate = np.diff(np.log(np.abs(gain - 1.0))) / np.diff(carried.schedule.time_s)
    np.testing.assert_allclose(rate, -1.0 / known["tau_s"], rtol=1e-6)


def test_an_instrument_keeps_a_zero_between_two_zeroings(carried: Scene) -> None:
    measured = carried.measured()
    made, known = applied("autozero_jumps", measured, 1e-4)
    zero_T = made.readings_T - measured.readings_T
    assert np.abs(zero_T[0]).max() < 1e-15
    is_new = np.abs(np.diff(zero_T, axis=0)).max(axis=1) > 1e-12
    assert is_new.sum() == known["zeros"]
    lengths = np.diff(np.flatnonzero(is_new))
    assert np.ptp(lengths) <= 1  # evenly in time
    assert 0.6e-4 < np.sqrt((zero_T[np.append(False, is_new)] ** 2).mean()) < 1.6e-4


def test_stages_are_those_of_the_links() -> None:
    assert {cause.name for cause in everyday.CAUSES if cause.stage == Stage.SENSOR} == {
        name for name in EVERYDAY if {"response", "zero"} & set(LINK[name])
    }
