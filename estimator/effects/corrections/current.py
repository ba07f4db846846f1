"""Corrections of the current of a coil, or of how much field an ampere makes."""

from __future__ import annotations

from estimator.effects.base import Theta
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.bases import Steps, Swings, Table, Wanders
from estimator.effects.corrections.correction import RANGE_A, Limit, constant, correction
from estimator.effects.corrections.targets import CurrentShare
from estimator.effects.history import LEAST_STEP
from estimator.effects.stages import Current
from estimator.tensors import Tensor, torch

MOST_REMEMBERED = 4


@correction(CurrentShare, Wanders, highest=40)
def current_wanders() -> None:
    """The coil's field per commanded ampere wanders with time.

    The current of a coil, or how much field an ampere makes, wanders: it warms up, sags, jumps or loosens.
    """


@correction(CurrentShare, Swings)
def current_swings() -> None:
    """The coil's field per commanded ampere swings with a period.

    The current of a coil swings, as of a regulator that hunts or of ripple that the readings' pace aliases.
    """


@correction(CurrentShare, Steps, single="current_step", highest=12)
def current_steps() -> None:
    """The coil's field per commanded ampere jumps.

    The current of a coil, or how much field an ampere makes, jumps: contacts, a core, a supply that was set anew.
    """


def _all_or_none(circumstances: Circumstances, place: str) -> Limit:
    """Highest degree; none where the current never changed."""
    least_A = LEAST_STEP * circumstances.largest_current_A
    if len(torch.unique((circumstances.commanded_A(place) / least_A).round())) > 1:
        return Limit(MOST_REMEMBERED)
    return Limit(0, "all readings are at one current; measure at others, of both signs")


def _history(key: str) -> str | None:
    """But for the sign, the way to a current is history."""
    return None if key.startswith("degree1") or key == "range_A" else "the currents before"


@correction(
    CurrentShare,
    Table,
    is_linear=False,
    highest=MOST_REMEMBERED,
    scales=(RANGE_A,),
    concerns=True,
    limit=_all_or_none,
    beyond_the_moment=_history,
)
def current_remembered(
    current_A: Current, theta: Theta, circumstances: Circumstances, coil: int
) -> dict[int, Tensor]:
    """The coil's field depends on the sign of its current and on the currents before.

    The field of a coil lags behind its current, or depends on its sign or on where it came from.

    Degree 1 differs by the sign of the current, degree 2 by the side from which it came, degree 3 goes with the reading before, degree 4
    with the current from which it last turned back.
    """
    range_A = constant(theta, "range_A")
    columns = {1: current_A.abs() / range_A}
    if not circumstances.is_moment:
        history_A = circumstances.observations.history.current_A[:, coil]
        before_A = torch.nn.functional.pad(history_A, (1, 0))[:-1]
        step_A = history_A - before_A
        is_step = step_A.abs() > LEAST_STEP * circumstances.largest_current_A
        last = torch.cummax(torch.arange(len(history_A), device=history_A.device) * is_step, dim=0).values
        row = circumstances.observations.row
        columns[2] = torch.where(is_step.any(), torch.sign(step_A[last]), torch.zeros_like(step_A))[row]
        columns |= {3: (before_A - history_A)[row] / range_A, 4: circumstances.last_turn_A(coil) / range_A}
    return {degree: column[..., None] for degree, column in columns.items()}
