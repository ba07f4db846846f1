"""Sessions that several tests of the open world look at."""

from __future__ import annotations

import pytest

from tests.hidden.frozen import Sessions, draw_sessions


@pytest.fixture(scope="session")
def sessions() -> Sessions:
    """One of each motion and protocol."""
    return draw_sessions()
