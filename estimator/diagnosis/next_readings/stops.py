"""Greedy choice of the next stops: poses and currents that best tell hypotheses apart or shrink a parameter's interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.derivatives import jacobian_of
from estimator.diagnosis.fitting import Fit
from estimator.diagnosis.next_readings.expected_evidence import Rows, continued, some_poses
from estimator.diagnosis.progress import OnCount, uncounted
from estimator.readings.observations import Observations

MOST_POSES = 150  # at which stops are considered: choosing each tries all
CURRENT_SHARES = (
    1.0,
    -1.0,
    0.5,
    0.0,
)  # of the largest current: what tells odd, even and cubic from no dependence

CHOOSING = "choosing stops"


def candidate_stops(session: Observations) -> Observations:
    """Poses of the session (at most `MOST_POSES`) at several currents, as readings that follow it in random order."""
    generator = torch.Generator().manual_seed(0)
    poses = some_poses(session, MOST_POSES, generator)
    rows, current_A = at_currents(session, poses, CURRENT_SHARES)
    order = torch.randperm(len(rows), generator=generator)
    return continued(session, rows[order], current_A[order])


def at_currents(
    session: Observations, poses: Int[Tensor, " pose"], shares: Sequence[float]
) -> tuple[Int[Tensor, " stop"], Float[Tensor, "stop coil"]]:
    """Every pose at every current: rows of the poses, and one coil after another at shares of the session's largest current."""
    n_coils = session.current_A.shape[1]
    each = torch.eye(n_coils, dtype=torch.float64) * session.current_A.abs().max()
    distinct = torch.unique(torch.cat([share * each for share in shares]), dim=0)
    return poses.repeat_interleave(len(distinct)), distinct.repeat(len(poses), 1)


def best_to_split(
    hypotheses: Mapping[str, Fit], stops: Observations, n: int, on_count: OnCount = uncounted
) -> tuple[Int[Tensor, " stop"], Float[Tensor, " value"]]:
    """Choose stops one by one, each to raise the expected log evidence of the worst pair of hypotheses most.

    Args:
        hypotheses: Fits of the same readings, two or more.
        stops: Candidates; each is chosen at most once.
        n: Number of stops.
        on_count: Called after each choice.
    Returns: Rows of `stops` in the order of choice, and the expected log evidence before the first and after each.
    """
    fits = list(hypotheses.values())
    pairs = [_Pair.of(truth, rival, stops) for truth in fits for rival in fits if truth is not rival]
    chosen: list[int] = []
    evidence = [torch.stack([pair.so_far for pair in pairs]).min()]
    for _ in range(min(n, len(stops))):
        expected = torch.stack([pair.with_each() for pair in pairs]).amin(0)
        expected[chosen] = -torch.inf
        best = int(expected.argmax())
        chosen.append(best)
        evidence.append(expected[best])
        for pair in pairs:
            pair.add(best)
        on_count(CHOOSING, len(chosen), n)
    return torch.tensor(chosen), torch.stack(evidence)


def best_to_shrink(
    fit: Fit, parameters: Sequence[str], stops: Observations, n: int, on_count: OnCount = uncounted
) -> tuple[Int[Tensor, " stop"], Float[Tensor, " value"]]:
    """Choose stops one by one, each to lower the standard deviation of a parameter most, or the rms of several of one unit.

    Args:
        fit: Of the readings so far.
        parameters: Free parameters of its rig, or such as depend on free ones.
        stops: Candidates.
        n: Number of stops.
        on_count: Called after each choice.
    Returns: Rows of `stops` in the order of choice, and the standard deviation before the first and after each, in the SI unit.
    """
    rows = Rows.of(fit, stops, fit.rig)
    columns = (rows.jacobian_T / rows.sigma_T[:, None]).unflatten(0, (len(stops), 3))

    def wanted(vector: Tensor) -> Tensor:
        values = fit.posterior.coordinates.values(vector)
        return torch.stack([values[name] for name in parameters], dim=-1)

    gradients = jacobian_of(wanted, fit.vector).reshape(len(parameters), -1)
    covariance = torch.linalg.inv(fit.optimum.precision[0])
    variance = (gradients @ covariance * gradients).sum(-1).mean()
    chosen: list[int] = []
    sds = [variance.sqrt()]
    for _ in range(min(n, len(stops))):
        by_each = lowered(covariance, columns, gradients) / len(gradients)
        by_each[chosen] = -torch.inf
        best = int(by_each.argmax())
        chosen.append(best)
        covariance = torch.linalg.inv(torch.linalg.inv(covariance) + columns[best].T @ columns[best])
        sds.append((gradients @ covariance * gradients).sum(-1).mean().sqrt())
        on_count(CHOOSING, len(chosen), n)
    return torch.tensor(chosen), torch.stack(sds)


def lowered(
    covariance: Float[Tensor, "*batch coordinate coordinate"],
    columns: Float[Tensor, "*batch stop row coordinate"],
    gradients: Float[Tensor, "*batch number coordinate"],
) -> Float[Tensor, "*batch stop"]:
    """Decrease of the summed variances of some numbers by each stop, to first order: Woodbury's identity with the rows of a stop.

    Args:
        covariance: Before the stop.
        columns: Derivatives of the readings of each stop in the coordinates, over their noise.
        gradients: Derivatives of the numbers in the coordinates.

    Examples:
        >>> lowered(torch.eye(1), torch.ones(1, 1, 1), torch.ones(1, 1))
        tensor([0.5000])
    """
    by_stop = columns.shape[-3:-1]
    # Few large products take a fifth of the time of many small ones.
    spread = (columns.flatten(-3, -2) @ covariance).unflatten(-2, by_stop)
    inner = torch.eye(by_stop[1]).to(columns) + spread @ columns.mT
    seen = (spread.flatten(-3, -2) @ gradients.mT).unflatten(-2, by_stop)
    return (torch.linalg.inv(inner) * (seen @ seen.mT)).sum((-1, -2))


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
        by_stop = (part.unflatten(0, (len(stops), 3)) for part in _whitened(*further))
        return cls(columns.T @ columns + rival.prior_precision, columns.T @ change, change @ change, *by_stop)

    @property
    def so_far(self) -> Float[Tensor, ""]:
        """Expected log evidence of the readings so far."""
        distance2: Tensor = self.square - self.score @ torch.linalg.solve(self.precision, self.score)
        return 0.5 * distance2

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
