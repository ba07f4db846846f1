"""Expected log evidence of readings not yet taken, to choose those that tell hypotheses apart.

Hypotheses are fits of the same readings. To first order about each fit, the expected log evidence is the Kullback-Leibler divergence of
their predictions: half the squared distance that remains after the false hypothesis has adjusted its parameters, and a term for the
difference of their scatters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.linear import Projector
from estimator.diagnosis.next_readings.turned import orientation, turned
from estimator.diagnosis.progress import OnCount, uncounted
from estimator.inference.likelihood import LogPosterior
from estimator.readings.observations import Observations
from estimator.readings.split import some_distinct
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.side_by_side import each

N_STOPS = 30  # readings that a proposed programme adds


@dataclass(frozen=True)
class Action:
    """Readings that could be taken next.

    Attributes:
        words: Instruction to the laboratory.
        readings: Poses and currents; the fields, not known yet, are 0.
        turned: Rotation vectors (rad) of sensors to be turned first, by name, in their present frames.
    """

    words: str
    readings: Observations
    turned: Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Proposal:
    """An action and its expected log evidence.

    Attributes:
        splits: Labels of the hypotheses.
        expected_log_evidence: Added for the true hypothesis against a false one, for the worst pair of the two.
    """

    action: Action
    splits: tuple[str, ...]
    expected_log_evidence: float

    def to_json(self) -> dict[str, Any]:
        """An entry of `next_measurement` in `diagnosis.json`."""
        return {
            "action": self.action.words,
            "splits": list(self.splits),
            "expected_log_evidence": self.expected_log_evidence,
        }


def proposals(
    hypotheses: Mapping[str, Fit], actions: Sequence[Action], on_count: OnCount = uncounted
) -> list[Proposal]:
    """Expected log evidence that each action would add to that of the readings so far, best first.

    Args:
        hypotheses: Fits of the same readings by label, two or more.
        actions: Actions to compare, such as those of `actions`.
        on_count: Called after each action.
    """
    seen = rows_seen(hypotheses)
    so_far = separation(hypotheses, seen)
    result = []
    for action, reached in zip(actions, each(partial(separation, hypotheses, seen), actions), strict=True):
        result.append(Proposal(action, tuple(hypotheses), (reached - so_far).min().item()))
        on_count("weighing programmes", len(result), len(actions))
    return sorted(result, key=lambda proposal: -proposal.expected_log_evidence)


def rows_seen(hypotheses: Mapping[str, Fit]) -> list[Rows]:
    """Predictions of each hypothesis for the readings that were fitted."""
    return [Rows.of(fit, fit.observations, fit.rig) for fit in hypotheses.values()]


def separation(
    hypotheses: Mapping[str, Fit], seen: Sequence[Rows], action: Action | None = None
) -> Float[Tensor, " pair"]:
    """Expected log evidence of the readings so far, or after an action, for every ordered pair of truth and rival.

    Args:
        hypotheses: Fits of the same readings by label.
        seen: Their `rows_seen`.
        action: Next action; None for the readings so far.
    """
    fits = list(hypotheses.values())
    more: list[Rows] = []
    if action is not None:
        more = [Rows.of(fit, *turned(action.readings, fit.rig, action.turned)) for fit in fits]
    pairs = permutations(range(len(fits)), 2)
    rows = list(zip(seen, more, strict=True)) if more else [(rows_so_far,) for rows_so_far in seen]
    return torch.stack([_distance(fits[j], rows[i], rows[j]) for i, j in pairs])


def actions(session: Observations, rig: Rig) -> list[Action]:
    """Actions that need no new equipment: other currents, another order, repeats at one pose, a turned sensor."""
    stops = some_poses(session, N_STOPS, torch.Generator().manual_seed(0))
    current_A = session.current_A[stops]
    largest_A = session.current_A.abs().max()
    still = stops[:1].expand(len(stops))
    n = len(stops)
    programmes = [
        ("the same poses again, in random order", stops, current_A),
        ("the same poses without current", stops, 0.0 * current_A),
        ("the same poses with the current reversed", stops, -current_A),
        ("the same poses at half the current", stops, 0.5 * current_A),
        ("one pose again and again", still, current_A[:1].expand(n, -1)),
    ]
    several = len(rig.coils) > 1
    for i, coil in enumerate(rig.coils):
        alone = torch.zeros_like(current_A)
        alone[:, i] = largest_A
        if several:
            programmes.append((f"the same poses with {coil.name} alone", stops, alone))
    result = [
        Action(f"{words}, {n} readings", continued(session, rows, currents), {})
        for words, rows, currents in programmes
    ]
    for sensor in rig.sensors:
        if orientation(rig, sensor.name) is None:
            continue
        for axis, turn in (("x", (1.0, 0.0, 0.0)), ("z", (0.0, 0.0, 1.0))):
            quarter = tuple(0.5 * torch.pi * part for part in turn)
            result.append(
                Action(
                    f"the same poses with {sensor.name} turned by 90 degrees about its {axis} axis, {n} readings",
                    continued(session, stops, current_A),
                    {sensor.name: (quarter[0], quarter[1], quarter[2])},
                )
            )
    return result


@dataclass(frozen=True)
class Rows:
    """Predictions of one hypothesis for some readings, to first order."""

    predicted_T: Float[Tensor, " component"]
    jacobian_T: Float[Tensor, "component coordinate"]
    sigma_T: Float[Tensor, " component"]

    @classmethod
    def of(cls, fit: Fit, readings: Observations, rig: Rig) -> Rows:
        """Predictions of a fit for some readings; the rig may differ from that of the fit in fixed numbers."""
        posterior = LogPosterior.by_rules(Coordinates(rig), readings, fit.posterior.model.rules)
        first_order = posterior.to_first_order(fit.vector)
        return cls(first_order.predicted_T, first_order.jacobian_T, first_order.sigma_T)


def _distance(rival: Fit, true_rows: tuple[Rows, ...], rival_rows: tuple[Rows, ...]) -> Tensor:
    """Expected log evidence for the truth against a rival, which adjusts its parameters within their priors.

    Kullback-Leibler divergence of two normal distributions: half the squared distance of the predictions in units of the rival's scatter,
    and a term for the difference of their scatters.
    """
    sigma_T = torch.cat([rows.sigma_T for rows in rival_rows])
    pairs = zip(true_rows, rival_rows, strict=True)
    change = torch.cat([truth.predicted_T - own.predicted_T for truth, own in pairs]) / sigma_T
    columns = torch.cat([rows.jacobian_T for rows in rival_rows]) / sigma_T[:, None]
    distance2 = Projector.of(columns, rival.prior_precision).gram(change[:, None], change[:, None])[0, 0]
    variance_ratio = (torch.cat([rows.sigma_T for rows in true_rows]) / sigma_T).square()
    return 0.5 * (distance2 + (variance_ratio - 1.0 - variance_ratio.log()).sum())


def some_poses(session: Observations, most: int, generator: torch.Generator) -> Int[Tensor, " pose"]:
    """Rows of a session at distinct poses of its sensors, at most so many, in random order."""
    key = torch.cat([session.sensor[:, None].double(), *session.motion.values()], dim=1)
    return some_distinct(key, most, generator)


def continued(
    session: Observations, rows: Tensor, current_A: Tensor, motion: Mapping[str, Tensor] | None = None
) -> Observations:
    """Readings taken after the session at its pace; their history includes the session.

    Args:
        session: Readings so far.
        rows: Of the session, whose sensors and poses the new readings have.
        current_A: New reading by coil.
        motion: Columns of movers that stand elsewhere than at those rows.
    """
    elsewhere = motion or {}
    history = session.history
    n = len(rows)
    time_s = history.time_s[-1] + session.pace_s * torch.arange(1.0, n + 1.0, dtype=torch.float64)
    later = Observations.of(
        current_A,
        {name: elsewhere.get(name, columns[rows]) for name, columns in session.motion.items()},
        torch.zeros(n, 3, dtype=torch.float64),
        time_s=time_s,
        sensor=session.sensor[rows],
        temperature_C={name: values.nanmean().expand(n) for name, values in history.temperature_C.items()},
        recorded_segment=history.segment[-1:].expand(n),
    )
    whole = replace(history, as_recorded=None).followed_by(later)
    return whole.rows(torch.arange(len(history), len(history) + n))
