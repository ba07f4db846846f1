"""A fit that stopped early has the same residual as a converged one, and no coordinate leaves its bounds for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.diagnosis.fitting import fit_rig
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.small_fits import fit_of, with_wrong


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


def test_a_fit_foretells_the_evidence_with_another_prior(small_rig, small_session):
    """A zero lies many stated widths off; with a prior ten times as wide it is far more probable."""
    zero, rules = (
        Cause("sensor_offset", "hall"),
        fit_of(small_rig, small_session.observations).posterior.model.rules,
    )
    readings = with_wrong(
        small_rig, small_session.observations, zero, {"x_T": 3e-3, "y_T": -2e-3, "z_T": 0.0}
    )
    fit = fit_of(small_rig, readings, zero)
    rig = with_effect(small_rig, zero, readings, {}, factor=10.0)
    made = fit_rig(rig, readings, fit.values, rules)
    assert made.log_evidence > fit.log_evidence + 5.0
    assert fit.foretold(rig).log_evidence == pytest.approx(made.log_evidence, abs=0.1)


def test_a_fit_has_nothing_of_a_cause_that_is_not_there(small_rig, small_session):
    zero = Cause("sensor_offset", "hall")
    readings = small_session.observations.calibration
    without = fit_of(small_rig, readings, zero)
    off = without.vector[without.at_null(zero)[0]]
    assert without.has_nothing_of(zero), off
    shift_T = 5.0 * without.posterior.sigma_T(without.vector)[0]
    moved = fit_of(small_rig, readings.with_field(readings.field_sensor_T + shift_T), zero)
    assert not moved.has_nothing_of(zero)
