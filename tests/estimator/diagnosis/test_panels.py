"""The panels of the page of the service agree with the diagnosis."""

from __future__ import annotations

import pytest
import torch
from pydantic import TypeAdapter

from estimator.diagnosis.panel_records import Panels
from estimator.diagnosis.panels import panels, panels_text
from estimator.diagnosis.structure.covariates import predicted_T, sensor_in_coils
from tests.estimator.diagnosis.reported import RADIUS

pytestmark = [pytest.mark.whole, pytest.mark.usefixtures("names_are_right")]


def test_panels_show_the_residuals_of_both_fits_where_the_sensor_was(diagnosis):
    made = panels(diagnosis)
    (around,) = made.maps
    plain, extended = diagnosis.fits.plain, diagnosis.fits.extended
    where_m = sensor_in_coils(extended)["coil1"]
    assert torch.allclose(torch.tensor(around.position_m, dtype=torch.float64), where_m, rtol=1e-4)
    for shown_T, fit in ((around.before_T, plain), (around.after_T, extended)):
        residual_T = fit.observations.field_sensor_T - predicted_T(fit)
        sizes_T = torch.tensor(shown_T, dtype=torch.float64).norm(dim=-1)
        assert torch.allclose(sizes_T, residual_T.norm(dim=-1), rtol=1e-4)  # turned, not stretched
    explained_T = torch.tensor(around.before_T) - torch.tensor(around.after_T)
    pattern_T = torch.tensor(around.patterns_T[diagnosis.sized_causes[0].name])
    assert (explained_T - pattern_T).abs().max() < 0.3 * made.noise_T
    assert around.winding is not None
    assert around.winding.outer_radius_m == pytest.approx(float(extended.values[RADIUS]))
    before, after = made.left_sigma
    assert before > 2.0
    assert after == pytest.approx(1.0, abs=0.2)


def test_panels_name_the_cause_its_rivals_and_what_it_moved(diagnosis):
    made = panels(diagnosis)
    (answer,) = made.answers
    assert {answer.label, *(name for name, _ in answer.alternatives)} == {"sensor_offset", "background_field"}
    assert any(size.startswith("x ") and "µT" in size for size in answer.sizes)
    race = made.races[0]
    values = [runner.log_bayes_factor for runner in race.runners]
    assert values == sorted(values, reverse=True)
    assert [runner.label for runner in race.runners if runner.role == "named"] == [answer.label]
    twins = [runner.label for runner in race.runners if runner.role == "alternative"]
    assert twins == [name for name, _ in answer.alternatives]
    nothing = next(runner for runner in race.runners if runner.label == "nothing")
    assert nothing.left_sigma is not None
    assert nothing.left_sigma == pytest.approx(made.left_sigma[0], rel=1e-3)
    radius = next(one for one in made.moved if one.shown.name == RADIUS)
    assert radius.before == (
        float(diagnosis.fits.plain.values[RADIUS]),
        diagnosis.fits.plain.value_sd(RADIUS),
    )
    assert radius.moved_sd == pytest.approx((radius.after[0] - radius.before[0]) / radius.before[1])
    assert TypeAdapter(Panels).validate_json(panels_text(made)) == made
