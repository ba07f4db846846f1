"""Mistakes of the record as a whole: exchanged sensors, rows that belong to other readings, units. Each is present or absent."""

from __future__ import annotations

from collections.abc import Mapping

from jaxtyping import Int

from estimator.effects.base import POSITIVE, Starts, Theta, switch, whole
from estimator.effects.causes.connections import TWO_BODIES, exchanged, pairs
from estimator.effects.circumstances import Circumstances
from estimator.effects.during import during
from estimator.effects.stages import Components, RecordEffect
from estimator.tensors import Tensor

FIELD_FACTORS = (1e3, 1e6, 1e4, 10.0, 0.1, 1e-3)  # mT, uT and G under T; G under mT; mT under G; T under mT
CURRENT_FACTORS = (1e3, 1e-3)  # mA under A, A under mA
MOST_ROWS = 2  # that a logger runs late or early
ROWS = whole(f"must be a whole number from {-MOST_ROWS} to {MOST_ROWS}", -MOST_ROWS, MOST_ROWS)


@RecordEffect.cause(
    "place_of",
    quantities=TWO_BODIES,
    places=lambda rig: ("record",) if len(rig.sensors) > 1 else (),
    starts=lambda circumstances: pairs(len(circumstances.rig.sensors)),
)
def sensors_exchanged(sensor: Int[Tensor, "*#batch row"], theta: Theta) -> Int[Tensor, "*#batch row"]:
    """Two sensors stand at each other's places, or their cables are exchanged.

    Source: any two sensors.
    """
    return exchanged(sensor, theta)


def _late_and_early(circumstances: Circumstances) -> Starts:
    """Late and early, where there is a row beside."""
    most = min(MOST_ROWS, len(circumstances.observations.history) - 1)
    return tuple({"rows": float(sign * n)} for n in range(1, most + 1) for sign in (1, -1))


# Quantities: rows by which fields come late; negative where they come early.
@RecordEffect.cause(
    "rows_late",
    source=f"buffers of loggers, {MOST_ROWS} readings at most",
    quantities=(switch("rows", -float(MOST_ROWS), float(MOST_ROWS), 0.0, ROWS),),
    starts=_late_and_early,
)
def rows_shifted(values: Mapping[str, float]) -> int:
    """Fields stand some rows beside the poses and currents that they belong to.

    Fields were written down some rows late or early: each belongs to the pose and the currents of another row.
    """
    return round(values["rows"])


@during(rows_shifted)
def rows_shifted_since() -> None:
    """From one instant on fields stand some rows beside the poses and currents that they belong to.

    From one instant on fields stand beside other rows: a trigger was missed, or a reading written twice, when two files were joined.

    Source: readings lost (negative) or written twice (positive), two at most.
    """


# Quantities: recorded over true fields, which scales the noise too; recorded over true currents.
@RecordEffect.cause(
    "recorded_T",
    quantities=tuple(switch(key, 0.0, 1e9, 1.0, POSITIVE) for key in ("field_factor", "current_factor")),
    # The usual slips between units.
    starts=(
        *({"field_factor": factor, "current_factor": 1.0} for factor in FIELD_FACTORS),
        *({"field_factor": 1.0, "current_factor": factor} for factor in CURRENT_FACTORS),
    ),
    commanded_A=lambda recorded_A, theta: recorded_A / theta["current_factor"][..., None, None],
    recorded_error_T=lambda error_T, theta: error_T * theta["field_factor"][..., None],
)
def unit_error(field_sensor_T: Components, theta: Theta) -> Components:
    """Fields or currents are in another unit than stated.

    Fields or currents are in another unit than the file says.

    Source: powers of ten between T, G, mT, uT and between A, mA.
    """
    return field_sensor_T * theta["field_factor"][..., None, None]
