"""What causes would do to the readings of a closed session, for the page's slider."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from estimator.diagnosis.what_if import PossibleCause, WhatIf, possible_causes, what_if
from estimator.service.requests import CoreOf, Id, router_of
from estimator.service.routes.sessions import closed_row_of

router = router_of("/v1/sessions", "sessions")
Label = Annotated[str, Query(min_length=1, max_length=200, description="As `axis_gain[hall]`.")]


@router.get("/{session_id}/causes")
def list_causes(core: CoreOf, session_id: Id) -> list[PossibleCause]:
    """Causes that could be in a session beside what its rig describes. The first call fits the session."""
    return possible_causes(core.fits[closed_row_of(core, session_id).id])


@router.get("/{session_id}/what-if")
def get_what_if(core: CoreOf, session_id: Id, cause: Label) -> WhatIf:
    """What a cause would add to each reading and what a fit would leave of it, for each unit of its size, to first order."""
    return what_if(core.fits[closed_row_of(core, session_id).id], cause)
