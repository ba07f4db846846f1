"""Designs that grow and shrink by stops, in the linearised model at draws of the parameters."""

from __future__ import annotations

from jaxtyping import Float

from estimator.diagnosis.next_readings.stops import lowered
from estimator.planning.information import Expected
from estimator.tensors import Tensor, torch

MOST_PASSES = 2  # of an exchange; the first one narrows intervals by a per cent or two beyond the greedy choice, a third by nothing


class Design:
    """Stops chosen so far, with the precision that they are expected to give.

    Without a goal the determinant of the precision counts (D-optimal), else the summed variances of the goals' numbers (I-optimal); both
    as means of logarithms over the draws.

    Attributes:
        chosen: Numbers of the stops, each as often as it is visited.
        precision: With them, by draw.
    """

    def __init__(self, expected: Expected) -> None:
        self.expected = expected
        self.chosen: list[int] = []
        self.precision = expected.precision
        # Rows with the same sum of squares as those of all goals, each goal with the weight of its mean: as many as coordinates.
        parts = [rows.mT @ rows / rows.shape[1] for rows in expected.wanted]
        size, axes = torch.linalg.eigh(torch.stack(parts).sum(0)) if parts else (None, None)
        self._rows = None if size is None else (axes * size.clamp(min=0.0).sqrt()[..., None, :]).mT

    @property
    def widths(self) -> Float[Tensor, " goal"]:
        """Half-widths over their targets, in the median of the draws."""
        return self.expected.widths(self.precision).median(-1).values

    def gains(self) -> Float[Tensor, " stop"]:
        """How much the logarithm of the criterion falls if a stop is added."""
        covariance, columns = torch.linalg.inv(self.precision), self.expected.columns
        if self._rows is None:
            spread = (columns.flatten(1, 2) @ covariance).view_as(columns)
            inner = spread @ columns.mT
            return torch.logdet(torch.eye(inner.shape[-1]).to(inner) + inner).mean(0)
        variance = ((self._rows @ covariance) * self._rows).sum((-1, -2))
        share = lowered(covariance, columns, self._rows) / variance[:, None]
        return -torch.log1p(-share.clamp(max=1.0 - 1e-12)).mean(0)

    def add(self, stop: int) -> None:
        """Visit a stop once more."""
        self.chosen.append(stop)
        self.precision = self.precision + self.expected.information(torch.tensor([stop]))

    def remove(self, place: int) -> int:
        """Leave out the visit at a place of the list; returns its stop."""
        stop = self.chosen.pop(place)
        self.precision = self.expected.precision + self.expected.information(
            torch.tensor(self.chosen, dtype=torch.int64)
        )
        return stop

    def grow(self, n: int) -> None:
        """Add stops one by one, each the one of greatest gain."""
        while len(self.chosen) < n:
            self.add(int(self.gains().argmax()))

    def exchange(self, most_passes: int = MOST_PASSES) -> None:
        """Replace each visit in turn by the best stop in its place, until nothing changes.

        References: Fedorov, Theory of Optimal Experiments (1972); coordinate exchange of Meyer and Nachtsheim, Technometrics 37, 60 (1995).
        """
        for _ in range(most_passes):
            is_changed = False
            for _ in range(len(self.chosen)):
                before = self.remove(0)
                gains = self.gains()
                best = int(gains.argmax())
                is_better = bool(gains[best] > gains[before] + 1e-9)
                self.add(best if is_better else before)
                is_changed |= is_better
            if not is_changed:
                return
