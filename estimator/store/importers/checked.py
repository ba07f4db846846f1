"""What happens to readings between a file and a session: their digits and units are judged, and a share is kept for validation."""

from __future__ import annotations

from typing import NamedTuple

from estimator.model.preflight import check_readings
from estimator.model.unit_gate import check_units
from estimator.readings.digits import flags_of_digits
from estimator.readings.flags import Flag, without_flagged
from estimator.readings.observations import Observations
from estimator.readings.split import with_validation
from estimator.rig.rig import Rig

VALIDATION_SHARE = 0.2


class Checked(NamedTuple):
    """Readings that can be fitted.

    Attributes:
        observations: The readings, some of them kept for validation.
        flags: Readings that cannot have been measured as they were recorded.
        warnings: Sentences on units and patterns.
    """

    observations: Observations
    flags: list[Flag]
    warnings: list[str]


def checked(
    rig: Rig, observations: Observations, source: str, share: float = VALIDATION_SHARE, seed: int = 0
) -> Checked:
    """Judge readings that were read, and keep a share of them for validation.

    Args:
        rig: The rig of the readings.
        observations: The readings as an importer made them.
        source: Their origin, for messages.
        share: Share of the readings that is kept out of the fit.
        seed: Decides which.
    Raises:
        InvalidInput: They cannot determine anything, or are in other units than they claim.
    """
    check_readings(rig, observations, source)
    flags = flags_of_digits(observations)
    warnings = check_units(rig, without_flagged(observations, flags), source)
    split = with_validation(observations, share, seed)
    check_readings(rig, split, source)  # the readings left to fit must suffice, too
    return Checked(split, flags, warnings)
