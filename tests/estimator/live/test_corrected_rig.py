"""A correction, and an iron core whose strength is free, are followed reading by reading as a calibration fits them."""

from __future__ import annotations

import pytest
import torch

from estimator.live.stream import Stream
from tests.estimator.conftest import CORED_SIZES, SIDEWAYS

pytestmark = pytest.mark.whole


def test_a_calibration_finds_both(cored_calibration):
    known = cored_calibration.summary()["parameters"]
    for name, size in CORED_SIZES.items():
        assert known[name]["median"] == pytest.approx(size, abs=3.0 * known[name]["sd"])
    assert known[SIDEWAYS]["sd"] < 0.3 * CORED_SIZES[SIDEWAYS]


def test_live_estimates_are_those_of_the_calibration(cored_rig, cored_session, cored_calibration):
    stream, readings = Stream(cored_rig), cored_session.observations.calibration.alone
    for rows in torch.arange(len(readings)).split(6):
        last = stream.update(readings.rows(rows))
    assert stream.alarms == ()
    known = cored_calibration.summary()["parameters"]
    for name in CORED_SIZES:
        assert last.intervals[name].value == pytest.approx(known[name]["median"], abs=0.5 * known[name]["sd"])
        assert last.intervals[name].sd == pytest.approx(known[name]["sd"], rel=0.25)
