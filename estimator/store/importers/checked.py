"""What happens to readings between a file and a session: their digits and units are judged, and a share is kept for validation."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from estimator.model.preflight import check_readings
from estimator.model.unit_gate import check_units
from estimator.readings.digits import flags_of_digits
from estimator.readings.flags import Flag, without_flagged
from estimator.readings.split import with_validation
from estimator.store.session import Session

VALIDATION_SHARE = 0.2


class Checked(NamedTuple):
    """Readings that can be fitted.

    Attributes:
        session: With readings kept for validation.
        flags: Readings that cannot have been measured as they were recorded.
        warnings: Sentences on units and patterns.
    """

    session: Session
    flags: list[Flag]
    warnings: list[str]


def checked(
    session: Session, share: float = VALIDATION_SHARE, seed: int = 0, source: str | None = None
) -> Checked:
    """Judge readings that were read, and keep a share of them for validation.

    Args:
        session: As an importer made it.
        share: Share of the readings that is kept out of the fit.
        seed: Decides which.
        source: Origin of the readings, for messages; as in the session where left out.
    Raises:
        InvalidInput: They cannot determine anything, or are in other units than they claim.
    """
    rig, source = session.rig, source or session.source
    check_readings(rig, session.observations, source)
    flags = flags_of_digits(session.observations)
    warnings = check_units(rig, without_flagged(session.observations, flags), source)
    session = replace(session, observations=with_validation(session.observations, share, seed))
    check_readings(rig, session.observations, source)  # the readings left to fit must suffice, too
    return Checked(session, flags, warnings)
