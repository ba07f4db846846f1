"""A source that no list holds: two dipoles that hang beside the coil of the small session and are driven by its current."""

from __future__ import annotations

import torch

from estimator.readings.observations import Observations
from estimator.store.session import Session

CURRENT_A = 3.0
NOISE_T = 5e-6
DIPOLES = (((0.11, 0.05, 0.06), (0.15, 0.25, -0.3)), ((-0.1, 0.06, 0.05), (0.2, -0.3, 0.25)))
"""Place in m and moment in A m^2 of each."""


def with_dipole(session: Session, sign: float = 1.0) -> Observations:
    """Readings of a session with the dipoles in them; the room's and the coil's axes are parallel."""
    observations = session.observations
    coil_z_m = session.truth["coil1.world_from_coil0.z_m"]
    at_m = -(observations.motion["arm1"][:, :3] + torch.tensor([0.0, 0.0, coil_z_m], dtype=torch.float64))
    field_T = torch.zeros_like(at_m)
    for place_m, full_A_m2 in DIPOLES:
        arm_m = at_m - torch.tensor(place_m, dtype=torch.float64)
        moment = (
            sign * observations.current_A[:, :1] / CURRENT_A * torch.tensor(full_A_m2, dtype=torch.float64)
        )
        r2 = arm_m.square().sum(-1, keepdim=True)
        field_T += 1e-7 * (3.0 * arm_m * (arm_m * moment).sum(-1, keepdim=True) - r2 * moment) * r2**-2.5
    return observations.with_field(observations.field_sensor_T + field_T)
