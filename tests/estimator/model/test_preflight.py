"""Checks before a fit: hopeless readings are refused by name, wrong units are recognised, honest readings never refused."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from estimator.errors import InvalidInput
from estimator.model.preflight import check_readings
from estimator.model.simulate import draw_truth, simulate
from estimator.model.unit_gate import check_units
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, load_plan
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text

pytestmark = pytest.mark.whole

HEAD = "schema_version: 1\nname: rig\n"
WINDING = """
    radius_mm: {prior: {normal: {mean: 51, sd: 1}}}
    wire_radius_mm: {prior: {normal: {mean: 0.98, sd: 0.05}}}
    axial_loops: {prior: {normal: {mean: 12, sd: 1}}}
    radial_loops: {prior: {normal: {mean: 6, sd: 1}}}
"""
POSE = """
      x_mm: {prior: {normal: {mean: 0, sd: 3}}}
      z_mm: {prior: {normal: {mean: -40, sd: 3}}}
      tilt_x_deg: {prior: {normal: {mean: 0, sd: 2}}}
"""
RIGS = {
    "displaced coil": f"""
movers: {{arm: {{motion: displacement}}}}
coils:
  coil1:
    carried_by: arm{WINDING}    world_from_coil0:{POSE}
sensors: {{hall: {{noise_uT: 20}}}}
""",
    "sensor on a mapper": f"""
movers: {{arm: {{motion: pose}}}}
coils:
  coil1:{WINDING}    world_from_coil:{POSE}
sensors: {{hall: {{carried_by: arm, noise_uT: 20}}}}
""",
    "coil on a robot": f"""
movers:
  arm:
    motion: UR3
    world_from_base: {{x_mm: -405, y_mm: 112, z_mm: {{prior: {{normal: {{mean: -481, sd: 3}}}}}}}}
coils:
  coil1:
    carried_by: arm{WINDING}    flange_from_coil: {{z_mm: {{prior: {{normal: {{mean: 70, sd: 1}}}}}}}}
sensors: {{hall: {{noise_uT: 20}}}}
""",
}
POSES = {
    "displaced coil": "x_mm: {from: -50, to: 50, count: 4}, y_mm: {from: -50, to: 50, count: 3}, z_mm: {from: -20, to: 20, count: 3}",
    "sensor on a mapper": "x_mm: {from: -50, to: 50, count: 3}, y_mm: {from: -40, to: 50, count: 3}, z_mm: {from: -10, to: 40, count: 2}, "
    "rx_deg: {from: -20, to: 60, count: 2}, rz_deg: {from: 0, to: 90, count: 2}",
    "coil on a robot": "q0_deg: {from: -4, to: 4, count: 3}, q1_deg: {from: -91, to: -88, count: 2}, q2_deg: -90, "
    "q3_deg: {from: -5, to: 5, count: 2}, q4_deg: {from: 84, to: 96, count: 3}, q5_deg: {from: -30, to: 30, count: 2}",
}
Change = Callable[[Observations], Observations]


@pytest.fixture(scope="module", params=RIGS)
def setup(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Rig, Plan]:
    rig = rig_from_text(HEAD + RIGS[request.param])
    path = tmp_path_factory.mktemp("plan") / "plan.yaml"
    path.write_text(
        f"{HEAD}poses: {{calibration: {{arm: {{{POSES[request.param]}}}}}}}\ncurrents_A: [{{coil1: 3}}]\n",
        encoding="utf-8",
    )
    return rig, load_plan(path, rig)


@pytest.fixture
def good(small_rig: Rig, small_plan: Plan) -> Observations:
    return simulate(small_rig, small_plan, {}, seed=0)


def read(rig: Rig, plan: Plan, seed: int, noise_T: float = 20e-6) -> Observations:
    return simulate(rig, plan, draw_truth(rig, seed) | {"hall.noise_T": noise_T}, seed)


def check(rig: Rig, observations: Observations) -> None:
    check_readings(rig, observations, "readings.csv")
    check_units(rig, observations, "readings.csv")


def refusal(rig: Rig, observations: Observations) -> str:
    with pytest.raises(InvalidInput) as caught:
        check(rig, observations)
    return str(caught.value)


def with_entry(tensor: torch.Tensor, row: int, value: float) -> torch.Tensor:
    changed = tensor.clone()
    changed[row] = value
    return changed


def moved(observations: Observations, position: float = 1.0, rotation: float = 1.0) -> Observations:
    """The motion as it stands in a file of other units; joint angles are rotations only."""
    factor = torch.tensor([position] * 3 + [rotation] * 3, dtype=torch.float64)
    return replace(observations, motion={name: m * factor for name, m in observations.motion.items()})


@pytest.mark.parametrize("noise_T", [20e-6, 200e-6])
def test_readings_of_30_random_truths_are_never_refused(setup, noise_T):
    rig, plan = setup
    for seed in range(30):
        check(rig, read(rig, plan, seed, noise_T))


UNITS: dict[str, tuple[Change, str]] = {
    "mT": (
        lambda o: o.with_field(o.field_sensor_T * 1e3),
        "fields look like mT called T, or uT called mT (or currents are too small by 1000)",
    ),
    "uT": (
        lambda o: o.with_field(o.field_sensor_T * 1e6),
        "fields look like uT called T, or nT called mT (or currents are too small by 1e+06)",
    ),
    "G": (
        lambda o: o.with_field(o.field_sensor_T * 1e4),
        "fields look like G called T, or mG called mT (or currents are too small by 10000)",
    ),
    "mA": (
        lambda o: replace(o, current_A=o.current_A * 1e3),
        "currents look like mA called A (or fields are too small by 1000)",
    ),
    "unknown factor": (
        lambda o: o.with_field(o.field_sensor_T * 100),
        "check units, currents and the nominal pose",
    ),
}


@pytest.mark.parametrize(
    ("setup", "unit"),
    [*(("displaced coil", unit) for unit in UNITS), ("sensor on a mapper", "mT"), ("coil on a robot", "mA")],
    indirect=["setup"],
)
def test_another_unit_of_field_or_current_is_named(setup, unit):
    change, message = UNITS[unit]
    rig, plan = setup
    refused = refusal(rig, change(read(rig, plan, 0)))
    assert refused.startswith("measured and nominal field must agree to a factor of 20; their ratio is ")
    assert f": {message}" in refused
    has_cure = "; if so, name them so in the file, or with --column " in refused
    assert has_cure == ("look like" in message)


def test_another_unit_of_positions_or_angles_is_named(setup):
    rig, plan = setup
    is_robot = len(rig.movers[0].columns[0].split("_q")) == 2
    has_rotations = any(pose["arm"][3:].any() for pose in plan.calibration)
    o, degree = read(rig, plan, 0), 180 / math.pi
    cases = {}
    if not is_robot:
        cases["mm called m, or um called mm: divided by 1000"] = moved(o, position=1e3)
        cases["cm called m: divided by 100"] = moved(o, position=1e2)
    if has_rotations or is_robot:
        angles = moved(o, degree if is_robot else 1.0, degree)
        cases["deg called rad: divided by 57.3"] = angles
    cure = "they fit the rig's nominal model; if so, name them so in the file, or with --column "
    for words, observations in cases.items():
        refused = refusal(rig, observations)
        assert f"stated; they look like {words}" in refused
        assert cure in refused


def test_units_of_a_session_with_zero_current_readings_are_judged_by_the_others(small_rig, good):
    offset_T = torch.tensor([0.0, 0.0, 0.05], dtype=torch.float64)
    off = replace(good, current_A=0.0 * good.current_A).with_field(good.field_sensor_T * 0 + offset_T)
    check_units(small_rig, good.rows(torch.arange(9)), "readings.csv")
    check(small_rig, good.followed_by(off))


REFUSALS: dict[str, tuple[Change, str]] = {
    "no readings": (lambda o: o.rows(torch.arange(0)),
        "session must hold calibration readings; it holds none"),
    "validation only": (lambda o: o.with_validation(torch.ones_like(o.is_validation)),
        "session must hold calibration readings; it holds none"),
    "one reading": (lambda o: o.rows(torch.arange(1)),
        "a calibration needs readings at several poses; received a single reading"),
    "one reading beside validation": (lambda o: o.with_validation(torch.arange(len(o)) > 0),
        "a calibration needs readings at several poses; received a single reading"),
    "fewer components than parameters": (
        lambda o: o.rows(torch.arange(2)).with_field(torch.tensor([[math.nan, math.nan, 1e-3]] * 2).double()),
        "readings must hold at least as many components as there are free parameters (3); received 2: "
        "take more, or write numbers that you know without a prior in the rig file"),
    "fewer components without those for validation": (
        lambda o: o.rows(torch.arange(3)).with_validation(torch.arange(3) > 1).with_field(
            torch.tensor([[math.nan, math.nan, 1e-3]] * 3).double()),
        "readings must hold at least as many components as there are free parameters (3); received 2 without the 1 of 3 readings for validation: "
        "take more, or write numbers that you know without a prior in the rig file, or keep fewer of them for validation"),
    "one pose": (lambda o: o.rows(torch.zeros(8, dtype=torch.int64)),
        "readings must be taken at several poses; all 8 share one"),
    "no current": (lambda o: replace(o, current_A=0.0 * o.current_A),
        "at least one coil must carry current; all currents are 0 A"),
    "dead sensor": (lambda o: o.with_field(0.0 * o.field_sensor_T),
        "sensors must show a field; every component is 0 T"),
    "NaN current": (lambda o: replace(o, current_A=with_entry(o.current_A, 4, math.nan)),
        "current must be finite; received nan at reading 4"),
    "infinite current": (lambda o: replace(o, current_A=with_entry(o.current_A, 4, math.inf)),
        "current must be finite; received inf at reading 4"),
    "NaN time": (lambda o: replace(o, time_s=with_entry(o.time_s, 2, math.nan)),
        "time must be finite; received nan at reading 2"),
    "infinite motion": (lambda o: replace(o, motion={"arm1": with_entry(o.motion["arm1"], 3, -math.inf)}),
        "motion of arm1 must be finite; received -inf at reading 3"),
    "NaN motion of a validation reading": (
        lambda o: replace(o, motion={"arm1": with_entry(o.motion["arm1"], 30, math.nan)}),
        "motion of arm1 must be finite; received nan at reading 30"),
    "infinite field": (lambda o: o.with_field(with_entry(o.field_sensor_T, 5, math.inf)),
        "field must be finite or empty; reading 5 is infinite"),
    "reading without components": (lambda o: o.with_field(with_entry(o.field_sensor_T, 6, math.nan)),
        "every reading must hold at least one component; reading 6 holds none"),
    "no components at all": (lambda o: o.with_field(o.field_sensor_T * math.nan),
        "every reading must hold at least one component; reading 0 holds none"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), REFUSALS.values(), ids=REFUSALS)
def test_readings_that_support_no_fit_are_refused(small_rig, good, change, message):
    check(small_rig, good)
    assert refusal(small_rig, change(good)) == f"{message} (readings.csv)"


def test_components_that_were_not_measured_are_no_fault(small_rig, good):
    field_T = good.field_sensor_T.clone()
    field_T[:, 0] = math.nan
    field_T[::2, 1] = math.nan
    check(small_rig, good.with_field(field_T))


def test_a_large_session_is_judged_by_some_of_its_readings(small_rig, good):
    large = good.rows(torch.arange(20_000) % len(good))
    check(small_rig, large)
    assert "mT" in refusal(small_rig, large.with_field(1e3 * large.field_sensor_T))
