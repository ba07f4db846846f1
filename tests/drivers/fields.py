"""Field of the simulated rig of the tests; a separate module, because the processes of the simulators import it."""

from __future__ import annotations

PER_AMPERE_T = 2e-3
ROOM_T = (2e-5, 0.0, -4e-5)


def along_z(snapshot):
    """Field along z proportional to the first current, and 10 mT along x per metre of the flange's x position."""
    x_T, y_T, z_T = ROOM_T
    along_x_m = snapshot.base_from_flange[0].position_m[0]
    return x_T + 0.01 * along_x_m, y_T, z_T + PER_AMPERE_T * snapshot.currents_A[0]
