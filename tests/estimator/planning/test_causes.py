"""Plans that make causes visible: they are then found at their size, and what cannot be told apart is refused by name."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator import InvalidInput, plan
from estimator.inference.running import RunningFit
from estimator.model.simulate import simulate
from estimator.planning.candidates import clear_candidates
from estimator.planning.causes import visible_half_widths, with_causes
from estimator.readings.plan import Plan, plan_from_text
from estimator.rig.rig import Rig


@pytest.fixture(scope="module")
def places(small_plan: Plan) -> Plan:
    return replace(small_plan, currents_A=({"coil1": 3.0}, {"coil1": -3.0}, {}))


@pytest.mark.whole
def test_a_planned_cause_shows_by_five_standard_deviations(small_rig, places):
    goal, name = "causes cross_axis[hall].xy=0.004", "cross_axis[hall].xy"
    planned = plan(small_rig, places, [goal])
    assert planned.expected[0][-1] <= 1.0
    readings = simulate(small_rig, plan_from_text(planned.text, small_rig), {}, 1, hidden={name: 0.004})
    rig = with_causes(small_rig, clear_candidates(places, small_rig, 0), [goal])
    fit = RunningFit(rig)
    fit.update(readings.calibration.alone, len(readings.calibration))
    column = fit.coordinates.names.index(name)
    size, sd = float(fit.vector[column]), float(fit.covariance[column, column].sqrt())
    assert sd <= 0.004 / 5.0 * 1.05
    assert abs(size - 0.004) < 4.0 * sd


def test_half_widths_are_a_fifth_of_the_size_as_a_standard_deviation(small_rig, places):
    words = ["axis_gain[hall].y=0.01", "sensor_offset"]
    rig = with_causes(small_rig, clear_candidates(places, small_rig, 0), [f"causes {' '.join(words)}"])
    widths = visible_half_widths(words, rig)
    offset = rig.parameters["sensor_offset[hall].x_T"]
    assert offset.prior is not None
    assert widths == pytest.approx(
        {"axis_gain[hall].y": 1.644854 * 0.002, "sensor_offset[hall].x_T": 1.644854 * offset.prior.sd / 5.0}
    )
    free = {parameter.name for parameter in rig.free}
    assert free == {parameter.name for parameter in small_rig.free} | set(widths)
    assert torch.isfinite(RunningFit(rig).vector).all()


@pytest.mark.parametrize(
    ("goal", "rule"),
    [
        ("causes background_field sensor_offset", "of background_field.*, sensor_offset.*cannot tell apart"),
        ("causes offset_drift", "must not depend on when a stop is visited; offset_drift"),
        ("causes backlash", "must not depend on when a stop is visited; backlash"),
        ("causes iron_on_sensor", "must change readings at the candidate stops; iron_on_sensor"),
        ("causes axis_gain.w", "given by one of x, y, z"),
        ("causes axis_gain=much", "sizes that are numbers"),
        ("causes axis_gane", "the closest is axis_gain"),
    ],
)
def test_causes_that_no_plan_makes_visible_are_refused(
    goal: str, rule: str, small_rig: Rig, places: Plan
) -> None:
    with pytest.raises(InvalidInput, match=rule):
        plan(small_rig, places, [goal])
