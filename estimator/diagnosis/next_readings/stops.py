"""Greedy choice of the next stops: poses and currents that best tell hypotheses apart or shrink a parameter's interval."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.derivatives import jacobian_of
from estimator.diagnosis import policy
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.next_readings.expected_evidence import Rows, continued
from estimator.readings.observations import Observations


def candidate_stops(session: Observations) -> Observations:
    """Poses of the session (at most `policy.MOST_POSES`) at several currents, as readings that follow it in random order."""
    key = torch.cat([session.sensor[:, None].double(), *session.motion.values()], dim=1)
    _, pose = torch.unique(key, dim=0, return_inverse=True)
    first = torch.full((int(pose.max()) + 1,), len(pose))
    first = first.scatter_reduce(0, pose, torch.arange(len(pose)), "amin")
    generator = torch.Generator().manual_seed(0)
    poses = first[torch.randperm(len(first), generator=generator)[: policy.MOST_POSES]]
    largest_A = session.current_A.abs().max()
    settings = []
    for coil in range(session.current_A.shape[1]):
        for share in policy.CURRENT_SHARES:
            setting = torch.zeros(session.current_A.shape[1], dtype=torch.float64)
            setting[coil] = share * largest_A
            settings.append(setting)
    distinct = torch.unique(torch.stack(settings), dim=0)
    rows = poses.repeat_interleave(len(distinct))
    order = torch.randperm(len(rows), generator=generator)
    return continued(session, rows[order], distinct.repeat(len(poses), 1)[order])


def best_to_split(
    hypotheses: Mapping[str, Fit], stops: Observations, n: int
) -> tuple[Int[Tensor, " stop"], Float[Tensor, " stop"]]:
    """Choose stops one by one, each to raise the expected log evidence of the worst pair of hypotheses most.

    Args:
        hypotheses: Fits of the same readings, two or more.
        stops: Candidates; each is chosen at most once.
        n: Number of stops.
    Returns: Rows of `stops` in the order of choice, and the expected log evidence after each.
    """
    fits = list(hypotheses.values())
    pairs = [_Pair.of(truth, rival, stops) for truth in fits for rival in fits if truth is not rival]
    chosen: list[int] = []
    evidence: list[Tensor] = []
    for _ in range(min(n, len(stops))):
        expected = torch.stack([pair.with_each() for pair in pairs]).amin(0)
        expected[chosen] = -torch.inf
        best = int(expected.argmax())
        chosen.append(best)
        evidence.append(expected[best])
        for pair in pairs:
            pair.add(best)
    return torch.tensor(chosen), torch.stack(evidence)


def best_to_shrink(
    fit: Fit, parameter: str, stops: Observations, n: int
) -> tuple[Int[Tensor, " stop"], Float[Tensor, " stop"]]:
    """Choose stops one by one, each to lower the standard deviation of a parameter most.

    Args:
        fit: Of the readings so far.
        parameter: A free parameter of its rig, or one that depends on free ones.
        stops: Candidates.
        n: Number of stops.
    Returns: Rows of `stops` in the order of choice, and the parameter's standard deviation after each, in its SI unit.
    """
    rows = Rows.of(fit, stops, fit.rig)
    columns = (rows.jacobian_T / rows.sigma_T[:, None]).unflatten(0, (len(stops), 3))
    gradient = jacobian_of(lambda vector: fit.posterior.coordinates.values(vector)[parameter], fit.vector)
    precision = fit.optimum.precision[0]
    chosen: list[int] = []
    sds: list[Tensor] = []
    for _ in range(min(n, len(stops))):
        with_each = precision + columns.mT @ columns
        sd = torch.sqrt((gradient * torch.linalg.solve(with_each, gradient.expand(len(stops), -1))).sum(-1))
        sd[chosen] = torch.inf
        best = int(sd.argmin())
        chosen.append(best)
        sds.append(sd[best])
        precision = with_each[best]
    return torch.tensor(chosen), torch.stack(sds)


class _Pair:
    """One true hypothesis against one rival: sums over the readings so far, and what each stop would add."""

    def __init__(
        self, precision: Tensor, score: Tensor, square: Tensor, columns: Tensor, change: Tensor
    ) -> None:
        self.precision, self.score, self.square = precision, score, square
        self.columns, self.change = columns, change

    @classmethod
    def of(cls, truth: Fit, rival: Fit, stops: Observations) -> _Pair:
        seen, further = (
            (Rows.of(truth, readings, truth.rig), Rows.of(rival, readings, rival.rig))
            for readings in (rival.observations, stops)
        )
        columns, change = _whitened(*seen)
        prior = (rival.optimum.precision - rival.optimum.information)[0]
        by_stop = (part.unflatten(0, (len(stops), 3)) for part in _whitened(*further))
        return cls(columns.T @ columns + prior, columns.T @ change, change @ change, *by_stop)

    def with_each(self) -> Float[Tensor, " stop"]:
        """Expected log evidence after each of the stops, were it next."""
        precision = self.precision + self.columns.mT @ self.columns
        score = self.score + (self.columns.mT @ self.change[..., None])[..., 0]
        followed = (score * torch.linalg.solve(precision, score)).sum(-1)
        distance2: Tensor = self.square + self.change.square().sum(-1) - followed
        return 0.5 * distance2

    def add(self, stop: int) -> None:
        """Add a stop to the readings so far."""
        columns, change = self.columns[stop], self.change[stop]
        self.precision = self.precision + columns.T @ columns
        self.score = self.score + columns.T @ change
        self.square = self.square + change @ change


def _whitened(truth: Rows, rival: Rows) -> tuple[Tensor, Tensor]:
    columns = rival.jacobian_T / truth.sigma_T[:, None]
    return columns, (truth.predicted_T - rival.predicted_T) / truth.sigma_T
