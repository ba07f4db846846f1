"""What small sessions say of themselves: with a source that no list holds, and with two causes."""

from __future__ import annotations

from dataclasses import replace

import pytest

from estimator.diagnosis import policy
from estimator.diagnosis.diagnose import diagnose
from estimator.diagnosis.mixture.answer import Answer
from estimator.diagnosis.result import Diagnosis
from estimator.readings.observations import Observations
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from tests.estimator.diagnosis.small_fits import OFFSET_T, answered, fit_of, with_wrong
from tests.estimator.diagnosis.unknown_source import with_dipole


@pytest.fixture(scope="session")
def of_nothing(small_rig: Rig, small_session: Session) -> Answer:
    """What readings say in which nothing is wrong."""
    return answered(fit_of(small_rig, small_session.observations.calibration))


@pytest.fixture(scope="session")
def dipole(small_session: Session) -> Observations:
    """Readings with an unknown dipole beside the coil."""
    return with_dipole(small_session)


@pytest.fixture(scope="session")
def of_dipole(small_rig: Rig, dipole: Observations) -> Answer:
    """What they say."""
    return answered(fit_of(small_rig, dipole.calibration))


@pytest.fixture(scope="session")
def two_causes(small_rig: Rig, small_session: Session) -> Observations:
    """Readings with a wrong gain of an axis and a zero that is off."""
    gain = with_wrong(small_rig, small_session.observations, Cause("axis_gain", "hall"), {"x": 0.05})
    return with_wrong(small_rig, gain, Cause("sensor_offset", "hall"), {"z_T": 100e-6})


@pytest.fixture(scope="session")
def of_two_causes(small_rig: Rig, two_causes: Observations) -> Answer:
    """What they say."""
    return answered(fit_of(small_rig, two_causes.calibration))


@pytest.fixture
def names_are_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """No name is an imitation, whatever the evidence of answers that are made by hand."""
    monkeypatch.setattr(policy, "IMITATION", (50.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@pytest.fixture(scope="session")
def diagnosis(small_rig: Rig, small_session: Session) -> Diagnosis:
    """The small rig with an offset, which a fixed sensor cannot tell from a field of the room."""
    flawed = with_wrong(
        small_rig, small_session.observations, Cause("sensor_offset", "hall"), {"x_T": OFFSET_T}
    )
    return diagnose(replace(small_session, observations=flawed), seed=1)
