"""The page of a calibration: sentences and tables a reader can take at their word."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from estimator.calibration.report import calibration_report
from estimator.calibration.result import Calibration

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def text(small_calibration: Calibration) -> str:
    return as_text(small_calibration)


def as_text(calibration: Calibration) -> str:
    """The page without its pictures and tags."""
    page = re.sub(r"<img[^>]*>", "", calibration_report(calibration, "coilcal calibrate"))
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", page)))


def test_error_stands_beside_what_noise_alone_would_leave(text):
    """5 uT of noise on each of three components."""
    assert f"would by itself leave {5.0 * np.sqrt(3.0):.4g} µT" in text
    assert "Noise as large as the rig file says" in text


def test_noise_of_components_that_were_not_measured_does_not_count(small_calibration):
    field_T = small_calibration.observations.field_sensor_T.clone()
    field_T[:, 0] = torch.nan
    field_T[small_calibration.observations.is_validation.nonzero()[0]] = torch.nan
    observations = small_calibration.observations.with_field(field_T)
    noise = {"hall.noise_T": np.full_like(small_calibration.log_prob, 5e-6)}
    page = as_text(
        replace(small_calibration, observations=observations, draws={**small_calibration.draws, **noise})
    )
    assert f"Noise as large as the fit found would by itself leave {5.0 * np.sqrt(2.0):.4g} µT" in page


def test_ends_of_an_interval_have_the_digits_of_the_median(text):
    number = r"(−?\d+\.?\d*)"
    median, sd, low, high = re.search(
        rf"coil1.radius {number} ± {number} {number} to {number} mm", text
    ).groups()
    decimals = {len(part.partition(".")[2]) for part in (median, sd, low, high)}
    assert len(decimals) == 1
    assert float(low) < float(median) < float(high)


def test_loop_counts_are_whole_numbers(text):
    assert re.search(r"coil1.axial_loops \d+ ± [\d.]+ \d+ to \d+ 1 ", text)


def test_a_stored_calibration_gives_the_page_it_gave_when_it_was_made(small_calibration, text, tmp_path):
    small_calibration.save(tmp_path)
    assert as_text(Calibration.load(tmp_path)) == text
