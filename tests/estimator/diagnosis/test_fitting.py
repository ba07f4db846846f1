"""A fit that stopped early has the same residual as a converged one, and no coordinate leaves its bounds for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.diagnosis.fitting import fit_rig
from estimator.effects.attach import with_effect
from estimator.inference import secant
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.mixture.weighed import weighed
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong


def test_what_is_left_does_not_depend_on_where_the_climb_stopped(small_rig, small_session):
    rig, observations = small_rig, small_session.observations
    whole = fit_of(rig, observations)
    near = {name: value + 0.3 * whole.value_sd(name) for name, value in whole.values.items()}
    early = fit_rig(rig, observations, near, whole.posterior.model.rules, tolerance=1e3)
    shift = early.posterior.predicted(early.vector) - whole.posterior.predicted(whole.vector)
    uncorrected = (shift * whole.whitening_per_T).norm()
    assert uncorrected > 0.05
    assert (early.residual - whole.residual).norm() < 0.05 * uncorrected
    gain = Cause("axis_gain", "hall")
    after, before = (weighed(fit, [gain])[gain][0] for fit in (early, whole))
    assert after == pytest.approx(before, abs=0.02)


def test_a_number_at_its_bound_is_not_pushed_beyond_it(small_rig, small_session):
    """A plate of strength zero leaves the residual of the rig without it."""
    observations = small_session.observations
    without = fit_of(small_rig, observations)
    wider = with_effect(
        small_rig, Cause("iron_plate", "room"), observations, {"axis": 2.0, "distance_m": 0.1}
    )
    rules = without.posterior.model.rules
    held = fit_rig(wider, observations, without.start_with(wider), rules, tolerance=1e9)
    slope = held.jacobian[:, held.posterior.coordinates.names.index("iron_plate[room].strength")]
    assert held.values["iron_plate[room].strength"] == 0.0
    assert (slope @ held.residual).abs() > 0.1
    torch.testing.assert_close(held.residual, without.residual, atol=1e-3, rtol=0.0)


def test_null_of_a_cause_is_that_of_its_sizes_and_a_logarithm_where_they_are_positive(
    small_rig, small_session
):
    """A winding's place is no size; a noise is fitted as a logarithm, with a factor of 1 as its null, or an sd of 0."""
    causes = {
        Cause("hidden_winding", "coil1"): {"turns": 0.0},
        Cause("noise_misstated", "hall"): {"factor": 1.0},
        Cause("position_jitter", "arm1"): {"sd_m": 0.0},
    }
    rig = small_rig
    for cause in causes:
        rig = with_effect(rig, cause, small_session.observations, {})
    rules = fit_of(small_rig, small_session.observations).posterior.model.rules
    fit = fit_rig(rig, small_session.observations, rig.nominal_values(), rules, tolerance=1e9)
    names = fit.posterior.coordinates.names
    for (cause, values), coordinate in zip(causes.items(), (0.0, 0.0, -torch.inf), strict=True):
        nulls = {f"{cause.label}.{key}": value for key, value in values.items()}
        assert {name: float(value) for name, value in fit.null_values(cause).items()} == nulls
        rows, null = fit.at_null(cause)
        assert [names[i] for i in rows] == list(nulls)
        assert null.tolist() == [coordinate]


AXES, GRADIENT = Cause("axis_gain", "hall"), Cause("background_gradient", "room")


def test_derivatives_of_a_fit_without_a_cause_are_those_of_the_fit_with_it_at_its_null(
    small_rig, small_session
):
    """A cause less and two more: nothing but the names of the coordinates says which derivatives are known."""
    observations = small_session.observations
    before = fit_of(small_rig, observations, AXES)
    rig = before.rig.without_cause(AXES)
    for cause in (Cause("sensor_offset", "hall"), GRADIENT):
        rig = with_effect(rig, cause, observations, {})
    after = fit_rig(rig, observations, before.values, before.posterior.model.rules, tolerance=1e9)
    start = after.posterior.coordinates.vector(
        {n: v for n, v in before.values.items() if n in rig.parameters}
    )
    given = before.slopes_for(after.posterior, start[None])
    exact = after.posterior.to_first_order(start[None])
    new = [i for i, name in enumerate(after.posterior.coordinates.names) if "[" in name]
    assert len(new) > 5
    torch.testing.assert_close(given.jacobian_T[..., new], exact.jacobian_T[..., new], rtol=1e-12, atol=0.0)
    size = exact.jacobian_T.abs().amax((0, 1))
    # The gains of the axes, which are gone, stood a little off one.
    assert ((given.jacobian_T - exact.jacobian_T).abs().amax((0, 1)) <= 0.05 * size).all()
    torch.testing.assert_close(given.log_sigma_jacobian, exact.log_sigma_jacobian)


def test_a_climb_from_the_derivatives_of_another_fit_ends_where_an_exact_one_does(
    small_rig, small_session, monkeypatch
):
    monkeypatch.setattr(secant, "MANY_DIRECTIONS", 1)
    observations = small_session.observations
    before = fit_of(small_rig, observations)
    rig = with_effect(before.rig, GRADIENT, observations, {})
    rules = before.posterior.model.rules
    near = fit_rig(rig, observations, before.start_with(rig), rules, near=before)
    monkeypatch.undo()
    exact = fit_rig(rig, observations, before.start_with(rig), rules)
    assert near.optimum.slopes is not None  # with which the climb ended
    assert exact.optimum.slopes is None
    torch.testing.assert_close(near.log_evidence, exact.log_evidence, atol=2e-3, rtol=0.0)
    torch.testing.assert_close(
        near.jacobian, near.posterior.jacobian(near.optimum.vector)[0] * near.whitening_per_T[:, None]
    )
    torch.testing.assert_close(near.residual, exact.residual, atol=0.02, rtol=0.0)


def test_another_start_is_taken_where_the_density_is_higher(small_rig, small_session):
    observations = small_session.observations
    before = fit_of(small_rig, observations)
    rig, rules = before.rig, before.posterior.model.rules
    far = {**before.values, "coil1.radius_m": before.values["coil1.radius_m"] * 1.05}
    own = {"coil1.radius_m": before.values["coil1.radius_m"]}
    there, back = (
        fit_rig(rig, observations, start, rules, tolerance=1e9, other_start=other)
        for start, other in ((far, own), (before.values, {"coil1.radius_m": far["coil1.radius_m"]}))
    )
    for fit in (there, back):
        assert float(fit.values["coil1.radius_m"]) == pytest.approx(float(own["coil1.radius_m"]), rel=1e-12)


def test_a_fit_has_nothing_of_a_cause_that_is_not_there(small_rig, small_session):
    zero = Cause("sensor_offset", "hall")
    readings = small_session.observations.calibration
    without = fit_of(small_rig, readings, zero)
    off = without.vector[without.at_null(zero)[0]]
    assert without.has_nothing_of(zero), off
    shift_T = 5.0 * without.posterior.sigma_T(without.vector)[0]
    moved = fit_of(small_rig, readings.with_field(readings.field_sensor_T + shift_T), zero)
    assert not moved.has_nothing_of(zero)


def test_evidence_at_a_bound_is_that_of_the_side_where_the_prior_is(small_rig, small_session):
    """Iron at a known place, where readings differ as no iron makes them: its volume stays at zero, which gains no evidence."""
    body, observations = Cause("iron_body", "room"), small_session.observations
    place_m = {"x_m": 0.03, "y_m": -0.05, "z_m": 0.05}
    iron = with_wrong(small_rig, observations, body, {**place_m, "volume_m3": 3e-6})
    readings = observations.with_field(2.0 * observations.field_sensor_T - iron.field_sensor_T)
    without = fit_of(small_rig, readings)
    rig = with_effect(small_rig, body, readings, place_m)
    rig = rig.with_parameters(replace(rig.parameters[f"{body.label}.{key}"], prior=None) for key in place_m)
    rules = without.posterior.model.rules
    held = fit_rig(rig, readings, without.values, rules)
    volume = rig.parameters[f"{body.label}.volume_m3"]
    assert float(held.values[volume.name]) < 1e-3 * volume.prior.sd
    nodes, weights = (torch.from_numpy(each) for each in np.polynomial.legendre.leggauss(12))
    half = 2.5 * held.value_sd(volume.name)
    sizes = half * (1.0 + nodes)
    fixed = rig.with_parameters([replace(volume, prior=None)])
    evidence = [
        fit_rig(fixed.with_values({volume.name: size}), readings, without.values, rules).log_evidence
        for size in sizes.tolist()
    ]
    rises = torch.tensor(evidence, dtype=torch.float64) - without.log_evidence
    density = torch.exp(volume.prior.log_density(sizes) + volume.prior.log_normaliser + rises)
    exact = float((half * weights * density).sum().log())
    missed_by_laplace = held.log_evidence - without.log_evidence - exact
    assert missed_by_laplace == pytest.approx(0.0, abs=0.1)
    assert bool((rises.diff() < 0.0).all())  # the density falls from the bound on
