from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _drawn(every_picture_is_drawn: None) -> None:
    """Here pages and pictures themselves are looked at."""
