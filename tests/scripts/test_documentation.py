"""Every cause can be shown in a session of the documentation, or `make docs` stops."""

from __future__ import annotations

import pytest

from estimator.effects import EFFECTS
from scripts.documentation.cause_patterns import Clean, place_that_shows, sessions
from scripts.documentation.causes import library

pytestmark = pytest.mark.whole  # 84 sessions, simulated twice: faster without checks of every call


@pytest.fixture(scope="module")
def clean() -> tuple[Clean, ...]:
    return sessions()


@pytest.mark.parametrize("name", library())
def test_a_session_shows_the_cause(name, clean):
    index, place = place_that_shows(EFFECTS[name], clean)
    assert place in EFFECTS[name].places(clean[index].rig)
