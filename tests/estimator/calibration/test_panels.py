"""What the page and the report show of a calibration: fields, what the data taught, and residuals by group."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from estimator.calibration.fitted import fitted
from estimator.calibration.panels import CalibrationPanels, calibration_panels
from estimator.calibration.report import calibration_report
from estimator.calibration.residual_groups import residual_groups
from estimator.calibration.result import Calibration
from estimator.effects.attach import with_effect
from estimator.rig.rig import Cause


@pytest.fixture(scope="module")
def panels(small_calibration: Calibration) -> CalibrationPanels:
    return calibration_panels(small_calibration)


def test_panels_are_json_and_hold_what_the_report_says(panels, small_calibration):
    json.dumps(asdict(panels), allow_nan=False)
    assert panels.headline[0].startswith(f"{panels.verdict}:".capitalize())
    assert [one.name for one in panels.taught] == [p.name for p in small_calibration.rig.free]
    assert len({one.words for one in panels.taught}) == len(panels.taught)
    assert len(panels.rms_sigma) == len(small_calibration.observations.calibration)
    assert (panels.coils, list(panels.movers)) == (["coil1"], ["arm1"])


def test_groups_say_where_a_residual_is(small_calibration):
    fit = fitted(small_calibration)
    o = small_calibration.observations
    changed_T, current_A = o.field_sensor_T.clone(), o.current_A.clone()
    half = torch.arange(len(o)) % 2 == 0
    current_A[half] = 0.0
    current_A[~half] += torch.linspace(-5e-4, 5e-4, int((~half).sum()))[
        :, None
    ]  # as a meter shows one setting
    changed_T[half] = 0.0
    changed_T[half, 1] = 5.0 * float(fit.sigma_T)
    changed_T[half, 2] = torch.nan
    changed = replace(
        small_calibration, observations=replace(o, current_A=current_A, field_sensor_T=changed_T)
    )
    groups = {(group.by, group.name): group for group in residual_groups(changed)}
    off = groups["current of coil1", "0 A"]
    assert off.n_readings == int((half & ~o.is_validation).sum())
    assert off.mean_sigma[:2] == pytest.approx((0.0, 5.0), abs=1e-6)
    assert off.mean_sigma[2] is None
    assert off.rms_sigma == pytest.approx(5.0 / np.sqrt(2.0))
    assert groups["current of coil1", "3 A"].rms_sigma < 2.0
    assert groups["component", "By"].rms_sigma > 3.0 > groups["component", "Bx"].rms_sigma
    heights = [group for (by, _), group in groups.items() if by == "height over coil1"]
    assert heights  # of readings with current alone, those with few left out
    assert sum(group.n_readings for group in heights) <= groups["current of coil1", "3 A"].n_readings
    assert "Residuals by current, axis, height and sensor" in calibration_report(changed, "")


def test_a_coil_that_only_a_cause_drives_is_in_the_report_without_heights(small_calibration):
    """Its rows count as powered although no current was commanded."""
    o = small_calibration.observations
    idle = replace(o, current_A=torch.zeros_like(o.current_A))
    rig = with_effect(small_calibration.rig, Cause("current_offset", "coil1"), o, {})
    driven = replace(
        small_calibration, rig=rig, observations=idle, best={**rig.nominal_values(), **small_calibration.best}
    )
    assert all(group.by != "height over coil1" for group in residual_groups(driven))
    assert residual_groups(driven)
