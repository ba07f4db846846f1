"""Corrections of the current of a coil, or of how much field an ampere makes."""

from __future__ import annotations

from estimator.effects.base import Theta
from estimator.effects.circumstances import LEAST_STEP, Circumstances
from estimator.effects.corrections.correction import RANGE_A, Correction, Limit
from estimator.effects.corrections.in_time import CurrentShare, Steps, Swings, Waves
from estimator.effects.stages import Current, OneCoilCurrent
from estimator.tensors import torch


class CurrentWanders(CurrentShare, Waves):
    """The current of a coil, or how much field an ampere makes, wanders: it warms up, sags, jumps or loosens."""

    name = "current_wanders"
    words = "the coil's field per commanded ampere wanders with time"
    highest = 40


class CurrentSwings(CurrentShare, Swings):
    """The current of a coil swings, as of a regulator that hunts or of ripple that the readings' pace aliases."""

    name = "current_swings"
    words = "the coil's field per commanded ampere swings with a period"


class CurrentSteps(CurrentShare, Steps):
    """The current of a coil, or how much field an ampere makes, jumps: contacts, a core, a supply that was set anew."""

    name = "current_steps"
    single = "current_step"
    words = "the coil's field per commanded ampere jumps"
    highest = 12


class CurrentRemembered(Correction, OneCoilCurrent):
    """The field of a coil lags behind its current, or depends on its sign or on where it came from.

    Degree 1 differs by the sign of the current, degree 2 by the side from which it came, degree 3 goes with the reading before, degree 4
    with the current from which it last turned back.
    """

    name = "current_remembered"
    words = "the coil's field depends on the sign of its current and on the currents before"
    is_linear = False
    unit = "1"
    components = ("share",)  # of the largest current of the session
    highest = 4
    scales = (RANGE_A,)

    def beyond_the_moment(self, key: str) -> str | None:
        """But for the sign, the way to a current is history."""
        return None if key.startswith("degree1") or key == "range_A" else "the currents before"

    def limit(self, circumstances: Circumstances, place: str) -> Limit:
        """Highest degree; none where the current never changed."""
        least_A = LEAST_STEP * circumstances.largest_current_A
        if len(torch.unique((circumstances.commanded_A(place) / least_A).round())) > 1:
            return Limit(self.highest)
        return Limit(0, "all readings are at one current; measure at others, of both signs")

    def delivered(self, current_A: Current, theta: Theta, circumstances: Circumstances, coil: int) -> Current:
        """Current in the coil, in A."""
        range_A = theta["range_A"].flatten()[0]
        history_A = circumstances.observations.history.current_A[:, coil]
        before_A = torch.nn.functional.pad(history_A, (1, 0))[:-1]
        step_A = history_A - before_A
        is_step = step_A.abs() > LEAST_STEP * circumstances.largest_current_A
        last = torch.cummax(torch.arange(len(history_A), device=history_A.device) * is_step, dim=0).values
        row = circumstances.observations.row
        by_degree = {
            1: current_A.abs() / range_A,
            2: torch.where(is_step.any(), torch.sign(step_A[last]), torch.zeros_like(step_A))[row],
            3: (before_A - history_A)[row] / range_A,
            4: circumstances.last_turn_A(coil) / range_A,
        }
        share = current_A.new_zeros(())
        for degree, amplitude in self.amplitudes(theta).items():
            if degree == 1 or not circumstances.is_moment:
                share = share + amplitude * by_degree[degree]
        return current_A + range_A * share
