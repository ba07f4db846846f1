"""Sessions that several tests of the open world look at."""

from __future__ import annotations

import numpy as np
import pytest

from tests.hidden.open_session import draw_open_scene
from tests.hidden.protocols import MOTIONS, PROTOCOLS
from tests.hidden.scene import Scene
from tests.hidden.stated_rig import StatedRig

Sessions = dict[tuple[str, str], tuple[StatedRig, Scene]]


@pytest.fixture(scope="session")
def sessions() -> Sessions:
    """One of each motion and protocol."""
    found: Sessions = {}
    rng = np.random.default_rng(17)
    while len(found) < len(MOTIONS) * len(PROTOCOLS):
        rig, scene = draw_open_scene(rng)
        found.setdefault((rig.motion, scene.schedule.protocol), (rig, scene))
    return found
