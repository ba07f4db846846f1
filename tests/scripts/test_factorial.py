"""What changes the field and what readings can tell apart: known answers for known functions, and the coil's own degeneracy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, observations_of
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from scripts.paper.factorial import factorial, information, levels_about, rms_change, rms_field, sobol

LEVELS = {"a": np.linspace(-1, 1, 7), "b": np.linspace(-1, 1, 7), "c": np.linspace(-1, 1, 7)}


def ishigami(x: Tensor) -> Tensor:
    return (
        torch.sin(x[..., 0]) + 7.0 * torch.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * torch.sin(x[..., 0])
    )


def test_variance_of_a_function_with_known_parts_is_shared_out_exactly():
    runs = factorial(lambda x: 2.0 * x[..., 0] + x[..., 1] + 3.0 * x[..., 0] * x[..., 2] + 5.0, LEVELS)
    assert runs.response.shape == (7, 7, 7)
    v = LEVELS["a"].var()
    whole = 4 * v + v + 9 * v**2
    shares = runs.shares()
    assert shares[("a",)] == pytest.approx(4 * v / whole)
    assert shares[("b",)] == pytest.approx(v / whole)
    assert shares[("c",)] == pytest.approx(0.0, abs=1e-12)
    assert shares["a", "c"] == pytest.approx(9 * v**2 / whole)
    assert shares["a", "b"] == pytest.approx(0.0, abs=1e-12)
    assert sum(shares.values()) == pytest.approx(1.0)
    np.testing.assert_allclose(runs.main_effect("b"), LEVELS["b"] + 5.0)
    table = runs.interaction("c", "a")
    np.testing.assert_allclose(table, 5.0 + LEVELS["a"] * (2.0 + 3.0 * LEVELS["c"][:, None]), atol=1e-12)
    np.testing.assert_allclose(runs.interaction("a", "c"), table.T)


def test_sobol_indices_of_the_ishigami_function_are_the_published_ones():
    """Saltelli et al., Global Sensitivity Analysis: The Primer (2008), section 4.6."""
    ends = {name: np.array([-np.pi, np.pi]) for name in LEVELS}
    indices = sobol(ishigami, ends, n=2048)
    np.testing.assert_allclose(indices.first, [0.3139, 0.4424, 0.0], atol=0.02)
    np.testing.assert_allclose(indices.total, [0.5576, 0.4424, 0.2437], atol=0.02)


@pytest.fixture
def readings(small_rig: Rig, small_plan: Plan) -> Observations:
    return observations_of(small_plan, small_rig, np.random.default_rng(0)).calibration


def test_a_run_is_the_rms_field_of_that_rig(small_rig, readings):
    names = ("coil1.axial_loops", "coil1.radius_m")
    levels = levels_about(small_rig, names, 3)
    np.testing.assert_allclose(levels["coil1.radius_m"], [0.050, 0.051, 0.052])
    runs = factorial(rms_field(small_rig, readings, names), levels)
    changed = small_rig.with_values({"coil1.axial_loops": 13.0, "coil1.radius_m": 0.050})
    values = {name: torch.tensor(value).double() for name, value in changed.nominal_values().items()}
    field_T = MeasurementModel.build(changed, readings).predict(values)
    assert runs.response[2, 0] == pytest.approx(float(field_T.square().sum(-1).mean().sqrt()), rel=1e-5)


def test_a_change_is_the_rms_difference_from_the_nominal_rig(small_rig, readings):
    names = ("coil1.axial_loops", "coil1.radius_m")
    runs = factorial(rms_change(small_rig, readings, names), levels_about(small_rig, names, 3), "RMSE")
    changed = small_rig.with_values({"coil1.radius_m": 0.050})
    fields = [
        MeasurementModel.build(rig, readings).predict(
            {name: torch.tensor(value).double() for name, value in rig.nominal_values().items()}
        )
        for rig in (small_rig, changed)
    ]
    expected_T = float((fields[1] - fields[0]).square().sum(-1).mean().sqrt())
    assert runs.response[1, 1] == 0.0
    assert runs.response[1, 0] == pytest.approx(expected_T, rel=1e-4)
    assert runs.label == "RMSE"


def test_information_is_that_of_differences_of_the_predicted_readings(small_rig, readings):
    names = ("coil1.radius_m", "coil1.axial_loops")
    fisher_information = information(small_rig, readings, names)
    columns = []
    for name, sd in zip(names, fisher_information.prior_sd, strict=True):
        ends = []
        for sign in (1, -1):
            moved = small_rig.with_values({name: small_rig.nominal_values()[name] + sign * 1e-3 * sd})
            values = {n: torch.tensor(v).double() for n, v in moved.nominal_values().items()}
            ends.append(MeasurementModel.build(moved, readings, 1e-9).predict(values))
        columns.append(((ends[0] - ends[1]) / 2e-3 / 5e-6).flatten().numpy())
    fisher = np.stack(columns) @ np.stack(columns).T
    np.testing.assert_allclose(fisher_information.alone_sd, 1.0 / np.sqrt(np.diag(fisher)), rtol=1e-3)
    np.testing.assert_allclose(
        fisher_information.together_sd, np.sqrt(np.diag(np.linalg.inv(fisher + np.eye(2)))), rtol=1e-2
    )
    values, vectors = np.linalg.eigh(fisher)
    np.testing.assert_allclose(fisher_information.sd_by_direction, values[::-1] ** -0.5, rtol=1e-2)
    assert abs(vectors[:, -1] @ fisher_information.directions[:, 0]) == pytest.approx(1.0, abs=1e-4)


def test_a_current_gain_beside_the_turns_is_a_direction_that_readings_know_worse(
    small_rig, readings, rig_text
):
    text = rig_text.replace(
        "radial_loops: 3", "radial_loops: 3\n    current_gain: {prior: {normal: {mean: 1, sd: 0.05}}}"
    )
    names = ("coil1.radius_m", "coil1.axial_loops", "coil1.current_gain")
    without, beside = (
        information(rig, readings, some)
        for rig, some in ((small_rig, names[:2]), (rig_from_text(text), names))
    )
    assert without.worth_fitting() == names[:2]
    assert beside.sd_by_direction[-1] > 4.0 * without.sd_by_direction[-1]
    weight = np.abs(beside.directions[:, -1])
    assert weight[0] < 0.2 < weight[1:].min()
    assert "least known combination" in beside.words()
    assert "coil1.current_gain" in beside.words().partition("least known combination")[2]


def test_noise_beyond_the_field_leaves_nothing_worth_fitting(small_rig, readings):
    fisher_information = information(
        small_rig.with_values({"hall.noise_T": 1.0}), readings, ("coil1.radius_m", "coil1.axial_loops")
    )
    assert fisher_information.worth_fitting() == ()
    assert fisher_information.n_determined == 0
    assert "Worth fitting" not in fisher_information.words()
    assert "Not by themselves: coil1.radius_m (to 1e+02 % of its prior width)" in fisher_information.words()


def test_parameters_without_prior_and_sensors_without_noise_are_refused(small_rig, readings):
    with pytest.raises(InvalidInput, match=r"parameters with a prior; received 'coil1.wire_radius_m'"):
        levels_about(small_rig, ("coil1.wire_radius_m",))
    with pytest.raises(InvalidInput, match="parameters with a prior; received 'coil1.colour'"):
        information(small_rig, readings, ("coil1.colour",))
    with pytest.raises(InvalidInput, match="noise of every sensor must be > 0"):
        information(small_rig.with_values({"hall.noise_T": 0.0}), readings, ("coil1.radius_m",))
