"""Kinds of corrections: the posterior of their amplitudes, what predictions have of them, and to what degree readings determine them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from estimator.diagnosis.corrections.kinds import kinds_of
from estimator.diagnosis.fitting import fit_rig
from estimator.effects import EFFECTS
from estimator.effects.attach import with_effect
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.correction import Correction, Limit
from estimator.effects.corrections.static import limit_of_places
from estimator.effects.use import is_in_field
from estimator.errors import InvalidInput
from estimator.model.measurement_model import MeasurementModel
from estimator.rig.parameters import Normal
from estimator.rig.rig import Cause
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from tests.estimator.diagnosis.small_fits import fit_of, predicted_T
from tests.estimator.diagnosis.unknown_source import NOISE_T, with_dipole

pytestmark = pytest.mark.whole

HARMONICS = Cause("coil_harmonics", "coil1")
N_TERMS = {1: 3, 2: 8, 3: 15, 4: 24, 5: 35}


def test_posterior_of_the_amplitudes_is_that_of_linear_least_squares(small_rig, small_session):
    """With all else fixed: precision X^T X / sigma^2 + 1 / w^2, with columns by differences of predictions."""
    width, flawed = 2e-6, with_dipole(small_session)
    rig = small_rig.with_fixed(p.name for p in small_rig.free)
    rig = with_effect(rig, HARMONICS, flawed, {"degree2_cos0_T_per_A": 0.0, "reach_m": 0.06})
    amplitudes = [p for p in rig.free if p.name.startswith(HARMONICS.label)]
    assert len(amplitudes) == N_TERMS[2]
    rig = rig.with_parameters(replace(p, prior=Normal(0.0, width)) for p in amplitudes)
    fit = fit_rig(rig, flawed, {}, MeasurementModel.build(rig, flawed).rules)
    zero_T = predicted_T(rig, flawed)
    columns = [(predicted_T(rig.with_values({p.name: 1.0}), flawed) - zero_T).flatten() for p in amplitudes]
    design = torch.stack(columns, dim=1)
    precision = design.T @ design / NOISE_T**2 + torch.eye(len(amplitudes)).double() / width**2
    mean = torch.linalg.solve(precision, design.T @ (flawed.field_sensor_T - zero_T).flatten() / NOISE_T**2)
    fitted = torch.stack([fit.values[p.name] for p in amplitudes])
    torch.testing.assert_close(fitted, mean, rtol=0.0, atol=1e-4 * width)
    torch.testing.assert_close(fit.covariance, torch.linalg.inv(precision), rtol=1e-6, atol=1e-12 * width**2)


def test_only_what_predictions_have_is_handed_out(small_rig, small_session):
    """Of a current that depends on what was before, its sign; nothing of time, of a sensor, or of where a probe was carried."""
    plain = fit_of(small_rig, small_session.observations.calibration)
    kinds = {kind.cause.name: kind for kind in kinds_of(plain)}
    handed_out = {name for name, kind in kinds.items() if kind.as_predicted(plain.rig) is not None}
    assert handed_out >= {"coil_harmonics", "guide_errors", "guide_swings"}
    assert handed_out <= {
        *("coil_harmonics", "coil_multipoles", "coil_bore", "room_harmonics", "room_bore", "room_answers"),
        *("guide_errors", "guide_swings", "current_remembered"),
    }
    assert handed_out < set(kinds)
    held = plain.rig
    carried = replace(held, sensors=tuple(replace(sensor, carried_by="arm1") for sensor in held.sensors))
    assert not is_in_field(carried, Cause("guide_errors", "arm1"))
    varied = replace(kinds["current_steps"], effect=EFFECTS["current_remembered"], limit=Limit(4))
    assert varied.as_predicted(plain.rig).limit.degree == 1


@pytest.mark.parametrize(
    ("places_m", "degree", "words"),
    [
        (torch.rand(200, 3, generator=torch.Generator().manual_seed(1)), 5, ""),
        (
            torch.rand(20, 3, generator=torch.Generator().manual_seed(1)),
            3,
            "20 places; measure at 24 or more",
        ),
        (torch.rand(2, 3).repeat(50, 1), 0, "one line"),
        (torch.rand(3, 3, generator=torch.Generator().manual_seed(1)), 1, "measure at 8"),
        (torch.rand(1, 3).expand(50, 3), 0, "move the sensor"),
        (torch.rand(90, 1) * torch.ones(3), 0, "measure beside it"),
        (
            torch.rand(90, 3, generator=torch.Generator().manual_seed(1)) * torch.tensor([1.0, 1.0, 0.0]),
            2,
            "off it",
        ),
    ],
)
def test_places_limit_the_degree(places_m, degree, words):
    limit = limit_of_places(places_m.double(), N_TERMS)
    assert limit.degree == degree
    assert words in limit.words


def test_field_of_the_room_is_refused_at_one_current_beside_a_coil_that_stands_still(small_session):
    effect = EFFECTS["room_harmonics"]
    assert isinstance(effect, Correction)
    observations = small_session.observations
    text = (
        rig_text(small_session.rig)
        .replace("    carried_by: arm1\n", "")
        .replace("world_from_coil0", "world_from_coil")
    )
    text = text.replace("hall: {", "hall: {carried_by: arm1, ")
    rig = rig_from_text(text)
    assert "measure without current" in effect.limit(Circumstances(rig, observations), "room").words
    off = replace(
        observations, current_A=observations.current_A * (torch.arange(len(observations)) % 2)[:, None]
    )
    assert effect.limit(Circumstances(rig, off), "room").degree > 0
    with pytest.raises(InvalidInput, match="must stand under corrections"):
        rig_from_text(rig_text(rig) + "effects:\n  zero_wanders[hall]: {duration_h: 1}\n")


def test_stops_that_are_read_once_have_no_errors_of_their_own(small_rig, small_session):
    """They would follow every reading; the limit says what to measure."""
    plain = fit_of(small_rig, small_session.observations.calibration)
    [kind] = [kind for kind in kinds_of(plain) if kind.cause.name == "stop_errors"]
    assert kind.limit.degree == 0
    n = len(small_session.observations)
    assert kind.limit.words == f"{n} readings are of {n} stops; read at most 100 stops, each several times"
