"""The shortest session that decides whether a calibration still holds: each stop is chosen by what is not excluded yet."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from jaxtyping import Float

from estimator.acquisition.pace import Pace
from estimator.calibration.result import Calibration
from estimator.planning.candidates import one_row_each
from estimator.planning.choosing import Chooser, Pilot
from estimator.planning.decision import Decided, Limits, refused_before
from estimator.readings.observations import Observations
from estimator.recalibration.changes import SCATTER, Changes, Expansion, Whitened
from estimator.recalibration.sequential import Innovations, Rates
from estimator.store.growing import observations_of
from estimator.tensors import Tensor, torch

# A change is named beside the leading one where its likelihood is at most so many times smaller
LIKELY = 20.0
MOST_NAMED = 5
HOLDS, CHANGED, UNDECIDED = "holds", "changed", "undecided"


@dataclass(frozen=True)
class Finding(Decided):
    """What readings so far say of a calibration.

    Attributes:
        outcome: `holds`, `changed` or `undecided`.
        leading: The change that is least excluded, and others that are about as likely where something has changed; with their sizes.
        ratio: Likelihood ratio of the leading change against none.
        left_out: Changes that these stops do not show.
        refused: Numbers of the candidates that instruments have refused.
    """

    outcome: str
    leading: tuple[str, ...]
    ratio: float
    left_out: tuple[str, ...]
    refused: tuple[int, ...]


class Recheck(Pilot):
    """Chooses stops until a calibration holds or has changed.

    Args:
        calibration: The one in use.
        stops: Candidates, a row for each sensor.
        share: Of the field, that a change is in the root mean square over the candidates.
        pace: Speeds and times.
        limits: Ends of the session beside its question.
        rates: Error rates.
    """

    def __init__(
        self,
        calibration: Calibration,
        stops: Observations,
        share: float,
        pace: Pace,
        limits: Limits,
        rates: Rates,
    ) -> None:
        self.rig, self.share, self.limits, self.rates = calibration.rig, share, limits, rates
        self.settings = one_row_each(stops, self.rig)
        self.chooser = Chooser(self.rig, self.settings, pace, 0)
        self.expansion = Expansion(calibration, stops)
        candidates = self.expansion.whitened(stops.with_field(torch.zeros_like(stops.field_sensor_T)))
        n_visits = limits.most_stops / len(self.settings)
        self.changes = Changes.of(self.expansion, candidates, share, n_visits, rates.misses)
        self._columns = candidates.columns.unflatten(0, (len(self.settings), -1))
        self._readings: list[Whitened] = []
        self._entries: list[Mapping[str, Any]] = []

    @property
    def rows(self) -> list[int]:
        """Candidates that were visited before the last decision, in order."""
        return [int(entry["decision"]["row"]) for entry in self._entries]

    @property
    def header(self) -> dict[str, Any]:
        """Question and limits of a session, from its journal."""
        return {"test": {"share": self.share, **asdict(self.rates)}, "limits": asdict(self.limits)}

    def decide(self, entries: Sequence[Mapping[str, Any]], refused: Sequence[int] = ()) -> Finding:
        """The judgement of the stops in a journal."""
        self._follow(entries)
        innovations = self._innovations()
        ratios = innovations.log_ratios(self.changes.sizes)
        left_out = refused_before(entries) | set(refused)
        outcome, row, reason = UNDECIDED, None, ""
        if entries and self.rates.has_changed(ratios):
            outcome, reason = CHANGED, f"the calibration has changed, by {len(entries)} stops"
        elif entries and self.rates.holds(ratios):
            outcome, reason = HOLDS, f"the calibration holds, by {len(entries)} stops"
        elif len(entries) >= self.limits.most_stops or len(left_out) == len(self.settings):
            reason = f"undecided after {len(entries)} stops"
        else:
            row, reason = self._next(ratios, left_out), "tells most by second of what is not excluded"
        names = self._leading(ratios, innovations, outcome == CHANGED)
        ratio = math.exp(min(float(ratios.max()), 300.0))
        left = self.changes.left_out
        return Finding(row, reason, outcome, names, ratio, left, tuple(sorted(left_out)))

    def _follow(self, entries: Sequence[Mapping[str, Any]]) -> None:
        """Take the stops that are new; all of them where earlier ones differ."""
        if list(entries[: len(self._entries)]) != self._entries:
            self._entries, self._readings = [], []
        for entry in entries[len(self._entries) :]:
            self._entries.append(entry)
            readings = observations_of(self._entries, self.rig)  # currents and moves before may act on
            is_new = torch.arange(len(readings)) >= len(readings) - len(observations_of([entry], self.rig))
            usable = is_new & readings.is_measured.any(-1)
            if usable.any():
                self._readings.append(self.expansion.whitened(readings.rows(usable)))

    def _innovations(self) -> Innovations:
        """All readings so far, in their order."""
        nothing = self._columns[0, :0]
        columns = torch.cat([nothing, *(each.columns for each in self._readings)])
        residual = torch.cat([nothing[:, 0], *(each.residual for each in self._readings)])
        sigma_T = torch.cat([nothing[:, 0], *(each.sigma_T for each in self._readings)])
        expansion, changes = self.expansion, self.changes
        own, asked = columns[:, expansion.own], columns[:, changes.numbers]
        return Innovations.of(residual, own, expansion.covariance, asked, changes.scatter_T / sigma_T)

    def _next(self, ratios: Float[Tensor, " hypothesis"], refused: set[int]) -> int:
        """The candidate that excludes most by second: each change counts until it is excluded."""
        left = (ratios[: len(self.changes.names)] - math.log(self.rates.misses)).clamp(min=0.0)
        gain = 0.5 * self.changes.sizes.square() * self._certainties()
        worth = torch.minimum(gain, left).sum(-1) + 1e-9 * gain.sum(-1)
        by_s = worth / self.chooser.next_s(self.rows)
        by_s[list(refused)] = -torch.inf
        return int(by_s.argmax())

    def _certainties(self) -> Float[Tensor, "stop change"]:
        """What a visit of each candidate would add to the certainty of each change, beside the calibration's own numbers."""
        own, asked = self.expansion.own, self.changes.numbers
        columns = torch.cat([self._columns[0, :0], *(each.columns for each in self._readings)])
        precision = torch.linalg.inv(self.expansion.covariance) + columns[:, own].T @ columns[:, own]
        followed = torch.linalg.solve(precision, columns[:, own].T @ columns[:, asked])
        here = self._columns[..., own]
        rest = self._columns[..., asked] - here @ followed
        spread = here @ torch.linalg.inv(precision) @ here.mT
        spread = spread + torch.eye(spread.shape[-1], dtype=spread.dtype)
        return (rest * torch.linalg.solve(spread, rest)).sum(-2)

    def _leading(self, ratios: Tensor, innovations: Innovations, has_changed: bool) -> tuple[str, ...]:
        """Names of the likeliest changes with their most probable sizes, or of the one that is least excluded."""
        likelihoods = (
            torch.cat((innovations.log_likelihoods(), ratios[len(self.changes.names) :]))
            if has_changed
            else ratios
        )
        order = likelihoods.argsort(descending=True, stable=True).tolist()[: MOST_NAMED if has_changed else 1]
        likely = [i for i in order if float(likelihoods[order[0]] - likelihoods[i]) <= math.log(LIKELY)]
        sizes, numbers = innovations.fitted_sizes().tolist(), self.changes.numbers.tolist()
        return tuple(
            self.expansion.words(numbers[i], sizes[i]) if i < len(sizes) else SCATTER for i in likely
        )
