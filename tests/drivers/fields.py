"""Field of the simulated rig of the tests; a separate module, because the processes of the simulators import it."""

from __future__ import annotations

import time

PER_AMPERE_T = 2e-3
ROOM_T = (2e-5, 0.0, -4e-5)


def along_z(snapshot):
    """Field along z proportional to the first current, and 10 mT along x per metre of the flange's x position."""
    x_T, y_T, z_T = ROOM_T
    along_x_m = snapshot.base_from_flange[0].position_m[0]
    return x_T + 0.01 * along_x_m, y_T, z_T + PER_AMPERE_T * snapshot.currents_A[0]


class SlowAtFirst:
    """The same field, whose first value with a current takes as long as loading code does on a busy computer."""

    LOADING_S = 1.5

    def __init__(self) -> None:
        self.is_loaded = False

    def __call__(self, snapshot):
        """Field at the sensor."""
        if any(snapshot.currents_A) and not self.is_loaded:
            time.sleep(self.LOADING_S)
            self.is_loaded = True
        return along_z(snapshot)
