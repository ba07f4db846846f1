"""Currents of one or several coils without their sign, in the Earth's field: told by fields that magpylib makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.first_fit import FirstFit
from estimator.diagnosis.lost_signs import lost_signs
from estimator.diagnosis.result import Question
from estimator.readings.flags import Flag, told
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session
from tests.independent.readings import coil_field_T

pytestmark = pytest.mark.whole

COIL = """
  {name}:
    radius_mm: {{prior: {{normal: {{mean: 50, sd: 1}}}}}}
    wire_radius_mm: 0.5
    axial_loops: 10
    radial_loops: 8
    world_from_coil: {{x_mm: {{prior: {{normal: {{mean: {x}, sd: 1}}}}}}, z_mm: -40}}"""
RIG = f"""
schema_version: 1
name: pair
movers: {{stage: {{motion: displacement}}}}
sensors: {{hall: {{carried_by: stage, noise_uT: 5}}}}
coils:{COIL.format(name="left", x=-60)}{COIL.format(name="right", x=60)}
"""
EARTH_T = np.array([18e-6, -4e-6, -43e-6])
SD_T, N = 5e-6, 120
LOSES = {"left": (0,), "both": (0, 1), "none": ()}


def rig() -> Rig:
    return rig_from_text(RIG)


def measured(
    loses: tuple[int, ...],
    seed: int = 1,
    *,
    is_in_order: bool = False,
    by_size: bool = False,
    is_one_way: bool = False,
    share: float = 1.0,
) -> tuple[Observations, np.ndarray]:
    """Readings with the signs of some coils lost, and the currents that flowed, a share of the usual ones."""
    rng = np.random.default_rng(seed)
    place_m = rng.uniform([-0.08, -0.05, 0.0], [0.08, 0.05, 0.06], (N, 3))
    current_A = share * rng.uniform(0.5, 2.0, (N, 2))
    flowed_A = current_A * (1.0 if is_one_way else rng.choice([-1.0, 1.0], (N, 2)))
    if is_in_order:  # forth in the first half and back in the second
        flowed_A[:, 0] = np.where(np.arange(N) < N / 2, 1.0, -1.0) * current_A[:, 0]
    if by_size:
        flowed_A[:, 0] = np.tile([1.0, -2.0, -1.0, 2.0], N // 4)
    field_T = EARTH_T + rng.normal(0.0, SD_T, (N, 3))
    for i, x_m in enumerate((-0.061, 0.0595)):  # a millimetre beside where the rig says
        field_T += flowed_A[:, i : i + 1] * coil_field_T(
            place_m - [x_m, 0.0, -0.04], 0.0505, 5e-4, 10, 8, 1.0
        )
    recorded_A = flowed_A.copy()
    recorded_A[:, loses] = np.abs(recorded_A[:, loses])
    motion = torch.zeros(N, 6, dtype=torch.float64)
    motion[:, :3] = torch.from_numpy(place_m)
    current_A, measured_T = torch.from_numpy(recorded_A), torch.from_numpy(field_T)
    readings = Observations.of(current_A, {"stage": motion}, measured_T, line=torch.arange(N) + 2)
    return readings, flowed_A


def told_before_a_search(readings: Observations) -> tuple[Flag, ...]:
    session = Session(rig(), readings, "lab.csv")
    return FirstFit.of(Question(session.rig, session.source, 1), session, None, 512).flags


@pytest.mark.parametrize("loses", LOSES.values(), ids=LOSES)
def test_the_readings_in_which_a_current_flowed_back_are_told_by_coil_and_line(loses):
    readings, flowed_A = measured(loses)
    flags = sorted(told_before_a_search(readings), key=lambda flag: flag.words)  # left, right
    assert len(flags) == len(loses)
    for i, flag in zip(loses, flags, strict=True):
        assert f"while the current of {('left', 'right')[i]} flowed the other way" in flag.words
        flowed_back = set(np.flatnonzero(flowed_A[:, i] < 0.0).tolist())
        assert set(flag.readings) <= flowed_back
        assert len(flag.readings) > 0.9 * len(flowed_back), "only far from the coil nobody can say"
        assert flag.lines[0] == flag.readings[0] + 2
        assert "readings between lines" in told([flag], ["hall"])


@pytest.mark.parametrize(("share", "least_told"), [(0.15, 0.6), (0.08, 0.4)])
def test_fields_far_below_that_of_the_earth_tell_them_too(share, least_told):
    """25 and 13 uT, beside 47 uT of the Earth and a noise of 5 uT for each component."""
    told, n_flowed_back = list[bool](), 0
    for seed in range(4):
        readings, flowed_A = measured((0, 1), seed, share=share)
        flags = sorted(lost_signs(rig(), readings).flags, key=lambda flag: flag.words)
        assert len(flags) == 2
        for flag, flowed_back in zip(flags, (flowed_A < 0.0).T, strict=True):
            told += flowed_back[list(flag.readings)].tolist()
            n_flowed_back += int(flowed_back.sum())
    assert sum(told) > least_told * n_flowed_back
    assert sum(told) > 0.98 * len(told)


@pytest.mark.parametrize("share", [1.0, 0.15, 0.08, 0.02])
def test_currents_that_flow_one_way_are_not_accused(share):
    for seed in range(6):
        readings, _ = measured((), seed, is_one_way=True, share=share)
        assert lost_signs(rig(), readings).flags == []


def test_signs_that_alternate_by_size_at_each_stop_are_told_too():
    """The plan of `coilcal init` measures so; of one size of the current each second reading was reversed."""
    readings, flowed_A = measured((0,), by_size=True)
    (flag,) = told_before_a_search(readings)
    assert len(flag.readings) > 0.9 * (flowed_A[:, 0] < 0.0).sum()


def test_most_readings_may_be_left_out_before_and_others_may_have_no_current():
    readings, flowed_A = measured((0,))
    field_T, current_A = readings.field_sensor_T.clone(), readings.current_A.clone()
    field_T[: N // 2 + 5] = torch.nan
    current_A[-20:] = 0.0
    field_T[-20:] = torch.from_numpy(EARTH_T)
    rest = replace(readings.with_field(field_T), current_A=current_A)
    (flag,) = lost_signs(rig(), rest).flags
    assert set(flag.readings) <= set(np.flatnonzero(flowed_A[:, 0] < 0.0).tolist())
    perfect = replace(rest, field_sensor_T=torch.zeros_like(field_T))
    assert lost_signs(rig(), perfect).flags == []


def test_one_change_of_sign_is_left_to_the_cause_of_the_library():
    readings, _ = measured((0,), is_in_order=True)
    assert told_before_a_search(readings) == ()


def test_a_coil_the_wrong_way_round_and_fields_of_another_pattern_are_no_lost_signs():
    readings, _ = measured((0, 1))
    right, flowed_A = measured(())
    for_all_T = torch.from_numpy(np.random.default_rng(0).normal(0.0, 2e-4, (N, 3)))
    assert told_before_a_search(readings.with_field(for_all_T)) == ()
    one_way = right.rows(torch.from_numpy((flowed_A > 0.0).all(axis=1)))
    reversed_A = one_way.current_A * torch.tensor([-1.0, 1.0], dtype=torch.float64)
    assert told_before_a_search(replace(one_way, current_A=reversed_A)) == ()


def test_a_diagnosis_leaves_them_out_and_names_the_field_of_the_earth():
    readings, _ = measured((0, 1))
    result = diagnose(Session(rig(), readings, "lab.csv"), seed=1, has_corrections=False)
    assert len(result.findings.flags) >= 2
    (named,) = result.causes  # the sensor never turns, so that a zero does the same
    assert {named.cause.name, *(other.cause.name for other in named.alternatives)} == {
        "background_field",
        "sensor_offset",
    }
