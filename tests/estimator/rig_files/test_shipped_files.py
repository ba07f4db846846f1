"""Every rig file that is shipped loads, and describes the laboratory it names."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch

from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig

pytestmark = pytest.mark.whole

CONFIGS = Path(__file__).parents[3] / "configs"
RIG_FILES = sorted(path.name for path in CONFIGS.glob("*.yaml"))  # settings, no rig
MU0 = 4e-7 * math.pi
FACING = [math.radians(q) for q in (0, -90, -90, 0, 90, 0)]


def field_at(rig: Rig, current_A: list[float], motion: dict[str, list[float]]) -> list[float]:
    """Predicted components of the rig's first sensor for one reading."""
    observations = Observations.of(
        torch.tensor([current_A], dtype=torch.float64),
        {name: torch.tensor([values], dtype=torch.float64) for name, values in motion.items()},
    )
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in rig.nominal_values().items()}
    return MeasurementModel.build(rig, observations).predict(values)[0].tolist()


def on_axis(z_m: float) -> list[float]:
    return [0.0, 0.0, z_m, 0.0, 0.0, 0.0]


def solenoid_T(turns: float, current_A: float, length_m: float, radius_m: float) -> float:
    """Field in the middle of a thin solenoid."""
    return MU0 * turns * current_A / math.hypot(length_m, 2 * radius_m)


@pytest.mark.parametrize("name", RIG_FILES)
def test_every_rig_file_loads_and_starts_inside_its_priors(name):
    rig = load_rig(CONFIGS / name)
    coordinates = Coordinates(rig)
    assert torch.isfinite(coordinates.log_prior(coordinates.vector({})))
    assert coordinates.n == len(rig.free) > 0
    values = rig.nominal_values()
    for coil in rig.round:
        turns = values[f"{coil.name}.axial_loops"] * values[f"{coil.name}.radial_loops"]
        assert 10 < turns < 20_000
        assert 0.02 < values[f"{coil.name}.radius_m"] < 0.5
    for sensor in rig.sensors:
        assert 1e-10 < values[f"{sensor.name}.noise_T"] < 1e-3


@pytest.mark.parametrize(
    ("name", "coil", "centre_m", "turns", "length_m", "radius_m"),
    [
        ("mice_ssu_m1", "M1", 3.448, 42 * 115, 0.2006, (0.25704 + 0.30159) / 2),
        ("mice_ssu_m2", "M2", 3.010, 28 * 114, 0.1989, (0.25698 + 0.28667) / 2),
        ("mice_ssu_e1_cc_e2", "E1", 2.615, 56 * 64, 0.1102, (0.25709 + 0.31650) / 2),
        ("mice_ssu_e1_cc_e2", "CC", 1.868, 20 * 768, 1.3101, (0.25712 + 0.27835) / 2),
        ("mice_ssu_e1_cc_e2", "E2", 1.121, 62 * 64, 0.1102, (0.25712 + 0.32290) / 2),
        ("mice_ssu", "M1", 3.448, 42 * 115, 0.2006, (0.25704 + 0.30159) / 2),
        ("mice_ssu", "CC", 1.868, 20 * 768, 1.3101, (0.25712 + 0.27835) / 2),
        ("goettingen_long", "coil1", 0.0, 825, 0.449, 0.06475),
        ("goettingen_thick", "coil1", 0.0, 499, 0.270, 0.100),
        ("goettingen_helmholtz", "coil1", 0.0325, 577, 0.015, 0.055),
        ("goettingen_helmholtz", "coil2", -0.0325, 577, 0.015, 0.055),
        ("maxwell_pair", "coil1", 0.0589, 320, 0.0096, 0.068),
    ],
)
def test_a_coil_alone_gives_the_field_of_a_thin_solenoid_at_its_centre(
    name, coil, centre_m, turns, length_m, radius_m
):
    rig = load_rig(CONFIGS / f"{name}.yaml")
    current_A = [float(c.name == coil) for c in rig.coils]
    mover = rig.movers[0].name
    centre, before, after = (
        field_at(rig, current_A, {mover: on_axis(centre_m + shift_m)})[2] for shift_m in (0.0, -0.01, 0.01)
    )
    assert centre == pytest.approx(solenoid_T(turns, 1.0, length_m, radius_m), rel=0.01)
    assert after == pytest.approx(before, rel=2e-4)  # so this is the middle


def test_equal_currents_of_the_maxwell_pair_oppose_each_other():
    rig = load_rig(CONFIGS / "maxwell_pair.yaml")
    middle = {"stage": on_axis(0.0)}
    assert field_at(rig, [1.9, 1.9], middle)[2] == pytest.approx(0.0, abs=1e-9)
    assert field_at(rig, [1.9, -1.9], middle)[2] == pytest.approx(2 * field_at(rig, [1.9, 0.0], middle)[2])


def on_axis_T(
    axial: int, radial: int, radius_m: float, wire_m: float, near_m: float, current_A: float
) -> float:
    """Field of a winding on its axis, loop by loop."""
    layers_m = [radius_m - wire_m * (2 * layer + 1) for layer in range(radial)]
    behind_m = [near_m + wire_m * (2 * turn + 1) for turn in range(axial)]
    return 0.5 * MU0 * current_A * sum(a**2 / math.hypot(a, z) ** 3 for a in layers_m for z in behind_m)


@pytest.mark.parametrize("coil", [0, 1])
def test_each_of_two_arms_holds_its_coil_40_mm_from_the_sensor(coil):
    rig = load_rig(CONFIGS / "two_arms.yaml")
    current_A = [float(i == coil) for i in range(2)]
    field_T = field_at(rig, current_A, {"arm1": FACING, "arm2": FACING})
    expected_T = on_axis_T(48, 25, 0.051, 0.49e-3, 0.040, 1.0)
    assert field_T[0] == pytest.approx((1 if coil == 0 else -1) * expected_T, rel=0.02)
    assert max(abs(b) for b in field_T[1:]) < 0.01 * abs(field_T[0])


def test_the_coil_of_the_paper_looks_at_the_sensor_from_the_distance_of_table_8():
    rig = load_rig(CONFIGS / "paper_experiment.yaml")
    field_T = field_at(rig, [3.0], {"arm1": FACING})
    expected_T = on_axis_T(115, 54, 0.0465, 0.30e-3, 0.0395, 3.0)
    assert field_T[0] == pytest.approx(expected_T, rel=0.01)


def test_coils_in_series_share_their_current_gain():
    rig = load_rig(CONFIGS / "mice_ssu_e1_cc_e2.yaml")
    raised = rig.with_values({"E1.current_gain": 1.01})
    at = {"mapper": on_axis(1.5)}
    assert field_at(raised, [30.0] * 3, at)[2] == pytest.approx(1.01 * field_at(rig, [30.0] * 3, at)[2])
