"""A registry over time, as the page draws it and `coilcal history` does: sessions, versions in use, every parameter."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, Field

from estimator.recalibration.timeline import judged, summary_of, versions_in_use
from estimator.service.answers import shown_as
from estimator.service.requests import CoreOf, Id, router_of
from estimator.service.routes.registries import registry_of

router = router_of("/v1/rigs/{rig_id}/registry", "registry")
MOST_SESSIONS = 500  # ten years of weekly ones
Numbers = Annotated[list[float], Field(min_length=2, max_length=3)]


class JudgedSession(BaseModel):
    """A session that was judged, and what it says of the parameters by itself."""

    session_id: str
    taken: datetime
    conclusion: str
    cause: Annotated[str, Field(description="Of a drift, in words.")]
    reason: str
    estimate: Annotated[dict[str, Numbers], Field(description="Value and standard deviation, in SI.")]


class PeriodOfUse(BaseModel):
    """A period in which a version was in use, by the time of readings."""

    version: int
    begin: datetime
    end: datetime
    intervals: Annotated[
        dict[str, Numbers], Field(description="Lower end, median and upper end of the 90 % interval, in SI.")
    ]


class RegistryHistory(BaseModel):
    """A registry over time, in order; of many sessions the last ones."""

    rig_name: str
    current: int | None
    units: Annotated[dict[str, str], Field(description="Unit of each parameter in SI.")]
    sessions: list[JudgedSession]
    periods: list[PeriodOfUse]


@router.get("/history")
def get_history(core: CoreOf, rig_id: Id) -> RegistryHistory:
    """Every parameter over time: what each session says of it, and the versions in use."""
    name, registry = registry_of(core, rig_id)
    entries = registry.entries()
    table = registry.history()
    sessions = [(entry, summary_of(entry)) for entry in judged(entries)[-MOST_SESSIONS:]]
    return RegistryHistory(
        rig_name=name,
        current=registry.current,
        units=dict(zip(table.parameter.values.tolist(), table.unit.values.tolist(), strict=True)),
        sessions=[
            JudgedSession(
                session_id=Path(entry.session).stem,
                taken=summary.taken,
                conclusion=summary.conclusion,
                cause=summary.label,
                reason=entry.reason,
                estimate={key: list(numbers) for key, numbers in summary.estimate.items()},
            )
            for entry, summary in sessions
        ],
        periods=[shown_as(PeriodOfUse, period) for period in versions_in_use(registry, entries)],
    )
