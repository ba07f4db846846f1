"""The exam's causes do what their sentences say, come back with their seed, and can be seen in sessions that are drawn for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimator.effects import EFFECTS
from tests.hidden.causes import unforeseen
from tests.hidden.flaw import Cause, Flaw
from tests.hidden.library import CAUSES, UNFORESEEN
from tests.hidden.open_session import adjustable_of, draw_open_scene, draw_open_session, within
from tests.hidden.scene import Scene
from tests.hidden.stated_rig import MOUNT_M, StatedRig
from tests.hidden.study import OPEN_KINDS, RELATIVES, draw_case
from tests.hidden.visible_size import effect_T

Drawn = tuple[StatedRig, Scene]
BY_CAUSE = pytest.mark.parametrize("cause", unforeseen.CAUSES, ids=lambda cause: cause.name)


def drawn(protocol: str, motion: str) -> Drawn:
    rng = np.random.default_rng(29)
    while True:
        rig, scene = draw_open_scene(rng)
        if (scene.schedule.protocol, rig.motion) == (protocol, motion):
            return rig, scene


@pytest.fixture(scope="module")
def recommended() -> Drawn:
    """Displacements, several currents, two sensors."""
    return drawn("recommended", "displacement")


@pytest.fixture(scope="module")
def carried() -> Drawn:
    """One current, one sensor, and a flange whose poses are written down."""
    return drawn("paper", "pose")


def applied(name: str, scene: Scene, size: float, seed: int = 3) -> tuple[Scene, dict[str, float]]:
    made, truth = CAUSES[name].apply(scene, size, np.random.default_rng(seed))
    return made, {p.name: p.value for p in truth.parameters}


def triple(known: dict[str, float], name: str, end: str = "") -> np.ndarray:
    return np.array([known[f"{name}_{axis}{end}"] for axis in "xyz"])


# ------------------------------------------------------------------------------- all of them


@BY_CAUSE
def test_no_size_changes_nothing_and_a_seed_brings_the_same_back(
    cause: Cause, recommended: Drawn, carried: Drawn
) -> None:
    for scene in (recommended[1], carried[1]):
        if scene.schedule.protocol not in cause.protocols:
            continue
        none, once, again = (
            effect_T(scene, [Flaw(cause, s, 5)]) for s in (0.0, cause.largest, cause.largest)
        )
        assert np.abs(none).max() < 1e-15
        assert np.abs(once).max() > 1e-6
        np.testing.assert_array_equal(once, again)


@BY_CAUSE
@pytest.mark.parametrize("sigma", [12.0, 30.0])
def test_every_one_becomes_as_visible_as_is_asked_for(cause: Cause, sigma: float) -> None:
    hidden = draw_open_session([29], within({cause.name}, is_known=True), sigma, 1)
    assert hidden.flaws[0].cause is cause
    assert 0.0 < hidden.flaws[0].size <= cause.largest
    assert hidden.visible[0].sigma == pytest.approx(sigma, rel=5e-3)
    assert hidden.rig is not None
    again = adjustable_of(hidden.rig, hidden.scene).visible_sigma(hidden.flaws)
    assert again == pytest.approx(hidden.visible[0].sigma)


def test_there_are_eight_at_the_end_of_the_list_and_kinds_that_hold_only_them() -> None:
    assert tuple(CAUSES)[-8:] == UNFORESEEN
    assert OPEN_KINDS[-2:] == ("unforeseen30", "unforeseen12")
    assert not {name for truth in UNFORESEEN for name in RELATIVES.get(truth, ())} - set(EFFECTS)
    one, learnt = (draw_case("unforeseen12", 3, library) for library in ((), UNFORESEEN))
    np.testing.assert_array_equal(one.record.field_T, learnt.record.field_T)
    assert one.flaws[0].cause.name in UNFORESEEN


# ------------------------------------------------------------------------------- one by one


def test_a_hunting_supply_swings_about_its_current(carried: Drawn) -> None:
    scene = carried[1]
    made, known = applied("supply_hunting", scene, 0.01)
    phase = 2.0 * np.pi * scene.schedule.time_s / known["period_s"] + known["phase_rad"]
    np.testing.assert_allclose(made.current_A / scene.current_A, 1.0 + 0.01 * np.sin(phase))
    assert 0.3 < known["period_s"] < 30.0


def test_a_saddle_is_the_same_after_half_a_turn_and_opposite_after_a_quarter(recommended: Drawn) -> None:
    scene = recommended[1]
    made, known = applied("warped_former", scene, 1e-3)
    points_m = np.random.default_rng(0).uniform([-0.05, -0.05, 0.02], [0.05, 0.05, 0.06], (20, 3))
    quarter = Rotation.from_rotvec([0.0, 0.0, np.pi / 2.0]).as_matrix()
    changes = []
    for turn in (np.eye(3), quarter, quarter @ quarter):
        turned_m = points_m @ turn.T
        changes.append((made.coil_field(turned_m) - scene.coil_field(turned_m)) @ turn)
    largest_T = np.abs(changes[0]).max()
    np.testing.assert_allclose(changes[2], changes[0], atol=1e-9 * largest_T)
    np.testing.assert_allclose(changes[1], -changes[0], atol=0.1 * largest_T)  # to first order of the rise
    assert known["rise_m"] == 1e-3


def test_a_saddle_is_nearer_where_it_rises(recommended: Drawn) -> None:
    scene = recommended[1]
    made, known = applied("warped_former", scene, 1e-3)
    points_m = np.array(
        [
            [0.045 * np.cos(a), 0.045 * np.sin(a), 0.02]
            for a in known["angle_rad"] + np.array([0.0, np.pi / 2.0])
        ]
    )
    high, low = np.linalg.norm(made.coil_field(points_m), axis=1) - np.linalg.norm(
        scene.coil_field(points_m), axis=1
    )
    assert low < 0.0 < high


def test_a_cage_adds_the_same_everywhere_and_follows_the_coil(recommended: Drawn) -> None:
    scene = recommended[1]
    made, known = applied("field_cancellation", scene, 0.5)
    probe_m = np.broadcast_to(triple(known, "probe", "_m"), scene.sensor_position_m.shape)
    added_T = made.sources[0](scene, scene.sensor_position_m)
    np.testing.assert_allclose(added_T, -0.5 * scene.coil_field_at(probe_m))
    np.testing.assert_array_equal(made.sources[0](scene, scene.sensor_position_m + 0.1), added_T)
    assert 0.2 < np.linalg.norm(probe_m[0]) < 0.3


def test_a_ring_of_cable_is_a_dipole_from_afar_and_stays_in_the_room(recommended: Drawn) -> None:
    scene = recommended[1]
    made, known = applied("coiled_cable", scene, 10.0)
    axis, place_m = triple(known, "axis"), triple(known, "position", "_m")
    far_m = np.broadcast_to(place_m + 20.0 * axis, scene.sensor_position_m.shape)
    moment_A_m2 = 10.0 * np.pi * known["radius_m"] ** 2 * scene.current_A
    expected_T = (2e-7 * moment_A_m2 / 20.0**3)[:, None] * axis
    field = made.sources[0]
    np.testing.assert_allclose(field(scene, far_m), expected_T, rtol=1e-4, atol=1e-18)
    elsewhere = replace(scene, displacement_m=scene.displacement_m + 0.03)
    np.testing.assert_array_equal(field(elsewhere, far_m), field(scene, far_m))


def test_a_loose_mount_rocks_to_the_side_that_a_move_left(recommended: Drawn, carried: Drawn) -> None:
    for _, scene in (recommended, carried):
        made, known = applied("rocking_mount", scene, 0.02)
        assert made.turn is not None
        before = np.broadcast_to(np.eye(3), made.turn.shape) if scene.turn is None else scene.turn
        rocked_rad = Rotation.from_matrix(before.swapaxes(1, 2) @ made.turn).as_rotvec()
        side = rocked_rad @ triple(known, "axis") / 0.01
        np.testing.assert_allclose(np.abs(side), 1.0)
        np.testing.assert_allclose(np.linalg.norm(rocked_rad, axis=1), 0.01)
        stays = np.linalg.norm(np.diff(scene.schedule.displacement_m, axis=0), axis=1) < 1e-9
        np.testing.assert_allclose(np.diff(side)[stays], 0.0, atol=1e-9)
        assert side.min() < 0.0 < side.max()


def test_the_flange_behind_a_rocking_coil_stays(recommended: Drawn) -> None:
    scene = recommended[1]
    made, _ = applied("rocking_mount", scene, 0.02)
    flange_m = [
        one.coil_origin_m() - one.from_coil_axes(np.broadcast_to(MOUNT_M, one.displacement_m.shape))
        for one in (made, scene)
    ]
    np.testing.assert_allclose(flange_m[0], flange_m[1], atol=1e-15)


def test_a_warm_stand_carries_all_sensors_along(recommended: Drawn) -> None:
    scene = recommended[1]
    made, known = applied("warm_stand", scene, 1e-4)
    growth = triple(known, "growth", "_m_per_K")
    assert np.linalg.norm(growth) == pytest.approx(1e-4)
    warm_K = scene.schedule.sensor_temperature_C - 25.0
    shift_m = made.sensor_position_m - scene.sensor_position_m
    np.testing.assert_allclose(shift_m, np.outer(warm_K, growth), atol=1e-15)
    np.testing.assert_array_equal(made.world_from_sensor, scene.world_from_sensor)


def test_the_coarse_range_is_off_and_the_fine_one_right(recommended: Drawn) -> None:
    scene = recommended[1].measured()
    made, known = applied("coarse_range", scene, 0.01)
    changed_T = made.readings_T - scene.readings_T
    is_off = np.abs(changed_T).max(axis=1) > 0.0
    assert 0.1 < is_off.mean() < 0.6
    assert np.abs(scene.readings_T[is_off]).max(axis=1).min() > known["range_T"]
    np.testing.assert_allclose(changed_T[is_off], known["excess"] * scene.readings_T[is_off], atol=1e-15)


def test_clocks_agree_at_first_and_are_apart_in_the_end(recommended: Drawn, carried: Drawn) -> None:
    scene = carried[1].measured()
    made, _ = applied("clocks_apart", scene, 0.1)
    late = 0.1 * np.arange(len(scene.readings_T)) / (len(scene.readings_T) - 1.0)
    joined = (1.0 - late[1:, None]) * scene.readings_T[1:] + late[1:, None] * scene.readings_T[:-1]
    np.testing.assert_allclose(made.readings_T[1:], joined, atol=1e-15)
    np.testing.assert_array_equal(made.readings_T[0], scene.readings_T[0])
    two = recommended[1].measured()
    assert np.abs(applied("clocks_apart", two, 0.1)[0].readings_T - two.readings_T).max() > 1e-6
