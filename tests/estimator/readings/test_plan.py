"""Plans: which readings they ask for, in which order, and how mistakes in them are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import qmc

from estimator.errors import InvalidInput
from estimator.readings.halton import halton
from estimator.readings.plan import Plan, load_plan, observations_of, plan_and_faults
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

RIG = """\
schema_version: 1
name: two of each
movers: {arm: {motion: UR3}, stage: {motion: displacement}}
coils:
  coil1: {carried_by: arm, radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}
  coil2: {radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}
sensors: {hall_a: {carried_by: stage, noise_uT: 5}, hall_b: {noise_uT: 5}}
"""
PLAN = """\
schema_version: 1
name: both arms
poses:
  calibration:
    arm: {q1_deg: -90, q5_deg: {from: 0, to: 180, count: 3}}
    stage: {z_mm: {from: -1, to: 1, count: 2}}
  validation:
    stage: {x_cm: 2}
currents_A: [{coil1: 3}, {coil1: -3, coil2: 0.5}]
order: raster
repeats: 2
settle_s: 0.25
"""


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(RIG)


def loaded(path: Path, rig: Rig, old: str = "", new: str = "") -> Plan:
    assert PLAN.count(old) == 1 or not old, old
    (path / "plan.yaml").write_text(PLAN.replace(old, new) if old else PLAN, encoding="utf-8")
    return load_plan(path / "plan.yaml", rig)


def rows(plan: Plan, rig: Rig, seed: int = 0) -> list[tuple]:
    """Readings as hashable rows: sensor, currents, joints and displacement, role, repeat."""
    o = observations_of(plan, rig, np.random.default_rng(seed))
    columns = (o.sensor, o.current_A, o.motion["arm"], o.motion["stage"], o.is_validation, o.repeat)
    return list(
        zip(*(tuple(tuple(np.atleast_1d(row).tolist()) for row in c.numpy()) for c in columns), strict=True)
    )


def test_a_pose_is_every_combination_of_the_stops_in_si(rig, tmp_path):
    plan = loaded(tmp_path, rig)
    joints = [pose["arm"].tolist() for pose in plan.calibration]
    displacements = [pose["stage"].tolist() for pose in plan.calibration]
    right = np.pi / 2
    assert joints == pytest.approx(
        np.array([[0, -right, 0, 0, 0, q5] for q5 in (0, 0, right, right, np.pi, np.pi)])
    )
    assert displacements == pytest.approx(np.array([[0, 0, z, 0, 0, 0] for z in (-1e-3, 1e-3) * 3]))
    assert [pose["stage"].tolist() for pose in plan.validation] == [[0.02, 0, 0, 0, 0, 0]]
    assert plan.validation[0]["arm"].tolist() == [0.0] * 6


def test_every_pose_is_read_by_every_sensor_at_every_setting_and_repeat(rig, tmp_path):
    visited_rows = rows(loaded(tmp_path, rig), rig)
    assert (
        len(visited_rows) == len(set(visited_rows)) == (6 + 1) * 2 * 2 * 2
    )  # poses, settings, repeats, sensors
    assert {row[1] for row in visited_rows} == {(3.0, 0.0), (-3.0, 0.5)}  # a coil that is not named is off
    assert sum(row[4] == (True,) for row in visited_rows) == 1 * 2 * 2 * 2
    assert [row[5] for row in visited_rows[:4]] == [(0,)] * 4


def test_raster_order_is_that_of_the_file_and_random_order_a_permutation_by_seed(rig, tmp_path):
    raster = loaded(tmp_path, rig)
    assert rows(raster, rig, seed=1) == rows(raster, rig, seed=2)
    assert [row[3][2] for row in rows(raster, rig)[:8:4]] == [-1e-3, 1e-3]
    random = loaded(tmp_path, rig, "order: raster", "order: random")
    assert rows(random, rig, seed=1) == rows(random, rig, seed=1) != rows(random, rig, seed=2)
    assert rows(random, rig, seed=1) != rows(raster, rig)
    assert set(rows(random, rig)) == set(rows(raster, rig))
    first, second = (
        [row[:4] for row in rows(random, rig) if row[4:] == ((False,), (repeat,))] for repeat in (0, 1)
    )
    assert first != second  # a repeat has an order of its own, so that drift does not look like position


def test_settings_at_one_pose_and_sensors_at_one_setting_follow_each_other(rig, tmp_path):
    plan = loaded(tmp_path, rig, "order: raster", "order: random")
    o = observations_of(plan, rig, np.random.default_rng(0))
    assert o.sensor.tolist() == [0, 1] * (len(o) // 2)
    assert o.time_s.tolist() == [0.25 * i for i in range(len(o) // 2) for _ in range(2)]
    stage = o.motion["stage"].reshape(-1, 4, 6)
    assert torch.equal(stage, stage[:, :1].expand_as(stage))
    assert torch.isnan(o.field_sensor_T).all()


def test_what_is_left_out_has_a_default(rig, tmp_path):
    (tmp_path / "plan.yaml").write_text(
        "schema_version: 1\nname: short\nposes: {calibration: {}}\ncurrents_A: [{coil1: 1e-3}]\n",
        encoding="utf-8",
    )
    plan = load_plan(tmp_path / "plan.yaml", rig)
    assert (plan.order, plan.repeats, plan.settle_s, plan.validation) == ("raster", 1, 1.0, ())
    assert plan.currents_A == ({"coil1": 1e-3},)
    assert len(observations_of(plan, rig, np.random.default_rng(0))) == 2


def test_halton_points_are_those_of_scipy_to_the_last_bit():
    """Plans of before are drawn again as they were."""
    for n_axes in (1, 2, 6, 12):
        assert np.array_equal(halton(n_axes, 1000), qmc.Halton(n_axes, scramble=False).random(1000))


def test_scattered_poses_fill_the_spans_of_all_axes_evenly(rig, tmp_path):
    spans = "    scattered: 200\n    arm: {q1_deg: -90, q5_deg: {from: 0, to: 180}}\n    stage: {z_mm: {from: -1, to: 1}}\n"
    grid = PLAN[PLAN.index("    arm:") : PLAN.index("  validation:")]
    plan = loaded(tmp_path, rig, grid, spans)
    poses = np.array([np.concatenate([pose["arm"], pose["stage"]]) for pose in plan.calibration])
    assert len(poses) == 200
    moved = np.ptp(poses, axis=0) > 0.0
    assert moved.nonzero()[0].tolist() == [5, 8]
    assert (poses[:, 1] == -np.pi / 2).all()
    share = (poses[:, moved] - np.array([0.0, -1e-3])) / np.array([np.pi, 2e-3])
    assert ((share > 0.0) & (share < 1.0)).all()
    counts, *_ = np.histogram2d(*share.T, bins=4, range=[[0, 1], [0, 1]])
    assert counts.min() >= 9  # of 12.5 on average; random points leave cells with 5
    assert np.abs(np.corrcoef(share.T)[0, 1]) < 0.05


CURRENTS = "[{coil1: 3}, {coil1: -3, coil2: 0.5}]"
REFUSALS = {
    "other version": ("schema_version: 1", "schema_version: 3", 1, "schema_version must be 1; received 3"),
    "unknown key": ("repeats: 2", "repeat: 2", 11, "repeat is not a known key; the closest is repeats"),
    "no poses": ("poses:", "pose:", 1, "poses is missing; the closest is pose"),
    "no calibration": ("  calibration:", "  calibrate:", 4,
        "poses.calibration is missing; the closest is calibrate"),
    "unknown mover": ("    stage: {x_cm: 2}", "    stages: {x_cm: 2}", 8,
        "poses.validation.stages must name a mover of rig 'two of each'; received 'stages' instead of arm "
        "or stage"),
    "no unit": ("x_cm: 2", "x: 2", 8,
        "poses.validation.stage.x must carry its unit: write x_m or x_cm or x_mm or x_um; received 2"),
    "joints of a stage": ("x_cm: 2", "q1_deg: 2", 8,
        "poses.validation.stage.q1_deg is not a known key; the closest is rz_deg"),
    "range as text": ("x_cm: 2", "x_cm: -2:2:5", 8,
        "poses.validation.stage.x_cm must be a finite number; received '-2:2:5'"),
    "nothing scattered": ("  validation:\n", "  validation:\n    scattered: 0\n", 8,
        "poses.validation.scattered must be a whole number of at least 1; received 0"),
    "no stops": ("count: 2", "count: 0", 6,
        "poses.calibration.stage.z_mm.count must be a whole number of at least 1; received 0"),
    "half a stop": ("count: 2", "count: 2.5", 6,
        "poses.calibration.stage.z_mm.count must be a whole number of at least 1; received 2.5"),
    "infinite range": ("from: -1", "from: -.inf", 6,
        "poses.calibration.stage.z_mm.from must be a finite number; received -inf"),
    "unknown coil": ("coil2: 0.5", "coil3: 0.5", 9,
        "currents_A must name coils of the rig (coil1, coil2); received {'coil1': -3, 'coil3': 0.5}"),
    "currents without coils": (CURRENTS, "[3]", 9,
        "currents_A must name coils of the rig (coil1, coil2); received 3"),
    "one setting": (CURRENTS, "{coil1: 3}", 9,
        "currents_A must be a list of settings such as [{coil1: 3}]; received {'coil1': 3}"),
    "no setting": (CURRENTS, "[]", 9,
        "currents_A must be a list of settings such as [{coil1: 3}]; received []"),
    "current in words": (CURRENTS, "[{coil1: three}]", 9,
        "currents_A must hold finite numbers; received {'coil1': 'three'}"),
    "current NaN": (CURRENTS, "[{coil1: .nan}]", 9,
        "currents_A must hold finite numbers; received {'coil1': nan}"),
    "current on": (CURRENTS, "[{coil1: on}]", 9,
        "currents_A must hold finite numbers; received {'coil1': True}"),
    "unknown order": ("raster", "Raster", 10,
        "order must be one of raster, random, mixed; received 'Raster'"),
    "no repeat": ("repeats: 2", "repeats: 0", 11, "repeats must be a whole number of at least 1; received 0"),
    "no time": ("settle_s: 0.25", "settle_s: 0", 12, "settle_s must be > 0; received 0"),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "line", "message"), REFUSALS.values(), ids=REFUSALS)
def test_a_mistake_is_named_and_has_no_followers(rig, tmp_path, old, new, message, line):
    with pytest.raises(InvalidInput) as caught:
        loaded(tmp_path, rig, old, new)
    assert str(caught.value) == f"{message} ({tmp_path / 'plan.yaml'}, line {line})"
    plan, faults = plan_and_faults(tmp_path / "plan.yaml", rig)
    assert (plan, [str(fault) for fault in faults]) == (None, [str(caught.value)])


STOPS = """\
schema_version: 1
name: two stops
settle_s: 2
stops:
  - {arm: {q1_deg: -90}, stage: {z_mm: 1}, current_A: {coil1: 3}}
  - {stage: {x_mm: -2}, current_A: {coil2: -0.5}}
"""


def with_stops(path: Path, rig: Rig, old: str = "", new: str = "") -> Plan:
    assert STOPS.count(old) == 1 or not old, old
    (path / "plan.yaml").write_text(STOPS.replace(old, new) if old else STOPS, encoding="utf-8")
    return load_plan(path / "plan.yaml", rig)


def test_stops_are_visited_one_by_one_with_their_own_currents(tmp_path, rig):
    asked = observations_of(with_stops(tmp_path, rig), rig, np.random.default_rng(1))
    assert asked.current_A.tolist() == [[3.0, 0.0], [3.0, 0.0], [0.0, -0.5], [0.0, -0.5]]  # two sensors
    assert asked.motion["stage"][:, [0, 2]].tolist() == [[0.0, 1e-3]] * 2 + [[-2e-3, 0.0]] * 2
    assert asked.motion["arm"][0, 1] == pytest.approx(-np.pi / 2.0)
    assert asked.time_s.tolist() == [0.0, 0.0, 2.0, 2.0]
    assert not asked.is_validation.any()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (", current_A: {coil2: -0.5}", "", "stops[1].current_A is missing"),
        ("{coil2: -0.5}", "{coil3: 1}", "stops[1].current_A must name coils of the rig (coil1, coil2)"),
        ("{x_mm: -2}", "{x: -2}", "stops[1].stage.x must carry its unit"),
        ("{x_mm: -2}", "{x_mm: -2, w_mm: 1}", "stops[1].stage.w_mm is not a known key"),
        ("  - {stage", "  - {arm2: {}, stage", "stops[1].arm2 is not a known key"),
    ],
)
def test_mistakes_in_stops_are_named(tmp_path, rig, old, new, words):
    with pytest.raises(InvalidInput) as caught:
        with_stops(tmp_path, rig, old, new)
    assert words in str(caught.value)
    assert "plan.yaml, line " in str(caught.value)


RECOMMENDED = """\
schema_version: 1
name: recommended
poses: {calibration: {arm: {q1_deg: -90}, stage: {z_mm: {from: -1, to: 1, count: 4}}}}
largest_A: {coil1: 3, coil2: 2}
"""


def test_a_plan_without_currents_follows_the_recommended_protocol(tmp_path, rig):
    (tmp_path / "plan.yaml").write_text(RECOMMENDED, encoding="utf-8")
    readings = observations_of(load_plan(tmp_path / "plan.yaml", rig), rig, np.random.default_rng(1))
    stops = readings.rows(torch.arange(0, len(readings), 2))
    currents_A = {tuple(row) for row in stops.current_A.tolist()}
    alone = {(level * 3.0, 0.0) for level in (0.5, -0.5, 1.0, -1.0)}
    alone |= {(0.0, level * 2.0) for level in (0.5, -0.5, 1.0, -1.0)}
    assert currents_A == {(0.0, 0.0)} | alone
    z_m = stops.motion["stage"][:, 2].reshape(-1, 9)
    assert bool((z_m == z_m[:, :1]).all())  # all currents at a pose before the next one
    visited = z_m[:, 0].tolist()
    assert visited[:2] == visited[2:4] == visited[6:]  # two poses three times: at first, half-way, at last
    assert len(set(visited)) == 4
    assert visited != sorted(visited)
    assert stops.repeat.reshape(-1, 9)[:, 0].tolist() == [0, 0, 1, 1, 0, 0, 2, 2]
    orders = {tuple(map(tuple, block.tolist())) for block in stops.current_A.reshape(-1, 9, 2)}
    assert len(orders) == 8


def test_what_the_protocol_decides_may_be_said_otherwise(tmp_path, rig):
    (tmp_path / "plan.yaml").write_text(RECOMMENDED + "order: raster\nrevisited: 0\n", encoding="utf-8")
    plan = load_plan(tmp_path / "plan.yaml", rig)
    assert (plan.order, plan.n_revisited) == ("raster", 0)
    for text in (RECOMMENDED + "currents_A: [{coil1: 1}]\n", RECOMMENDED.replace("largest_A", "currents")):
        (tmp_path / "plan.yaml").write_text(text, encoding="utf-8")
        with pytest.raises(InvalidInput, match="largest_A|currents_A is missing"):
            load_plan(tmp_path / "plan.yaml", rig)


def test_mistakes_of_all_parts_are_told_at_once(rig, tmp_path):
    path = tmp_path / "plan.yaml"
    wrong = {
        "order: raster": "order: rastre",
        "x_cm: 2": "x_kg: 2",
        "repeats: 2": "repeats: 0",
        "coil2: 0.5": "coil3: 0.5",
    }
    text = PLAN
    for old, new in wrong.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    told = [str(fault).partition(" ")[0] for fault in plan_and_faults(path, rig)[1]]
    assert told == ["poses.validation.stage.x_kg", "currents_A", "order", "repeats"]
