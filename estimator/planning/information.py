"""What stops are expected to say: the linearised model at draws of the parameters.

Noise is left out of the coordinates. The expected information on it has no cross terms with the field, and each reading adds the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from estimator.errors import InvalidInput
from estimator.field.winding_shape import Rule
from estimator.inference.levenberg_marquardt import prior_gradient_and_precision
from estimator.inference.likelihood import LogPosterior
from estimator.model.clearance import clearance_m
from estimator.model.measurement_model import MeasurementModel
from estimator.planning.goals import Goal
from estimator.readings.observations import Observations
from estimator.rig.coordinates import Coordinates
from estimator.rig.rig import Rig
from estimator.tensors import Tensor, torch

MOST_VISITS = 100  # of every candidate: a goal that they do not reach is out of reach
N_DRAWS = 64  # of the prior; with 32 or 128 the paper's coil needs the same number of stops to within one


@dataclass(frozen=True)
class Expected:
    """The linearised model of some stops and goals at draws of the parameters.

    Attributes:
        coordinates: Of the rig; `known` are those but noise.
        at: The draws.
        precision: Before any of the stops, by draw: that of the prior, or of readings so far.
        columns: Derivatives of the readings of each stop over their noise.
        wanted: Rows of each goal (`estimator.planning.goals`).
        widest: Whether each goal is about the widest interval rather than the mean one.
    """

    coordinates: Coordinates
    at: Float[Tensor, "draw all"]
    precision: Float[Tensor, "draw coordinate coordinate"]
    columns: Float[Tensor, "draw stop row coordinate"]
    wanted: Sequence[Float[Tensor, "draw _ coordinate"]]
    widest: Sequence[bool]

    @classmethod
    def of(
        cls,
        rig: Rig,
        stops: Observations,
        goals: Sequence[Goal],
        at: Float[Tensor, "draw all"],
        rules: Mapping[str, Rule] | None = None,
    ) -> Expected:
        """The model at draws, before any stop.

        Args:
            rig: With priors.
            stops: Candidates, a row for each sensor.
            goals: What shall be known.
            at: Coordinates to linearise at.
            rules: Quadrature rules of the windings at these stops, where they are known already.
        """
        coordinates = Coordinates(rig)
        known = known_coordinates(coordinates)
        unread = stops.with_field(torch.zeros_like(stops.field_sensor_T))
        model = MeasurementModel.unruled(rig, unread)
        model = model.choose_rules(model.nominal) if rules is None else model.with_rules(rules)
        posterior = LogPosterior(coordinates, model, unread)
        first = posterior.to_first_order(at)
        columns = (first.jacobian_T / first.sigma_T[..., None])[..., known]
        _, precision = prior_gradient_and_precision(coordinates, at)
        wanted = [goal.rows(coordinates, at)[..., known] for goal in goals]
        return cls(
            coordinates,
            at,
            precision[:, known][..., known],
            columns.unflatten(1, (-1, 3 * len(rig.sensors))),
            wanted,
            [goal.is_worst for goal in goals],
        )

    @property
    def n_stops(self) -> int:
        """Number of candidates."""
        return self.columns.shape[1]

    def only(self, columns: Bool[Tensor, " coordinate"]) -> Expected:
        """The model where only some of the columns are free."""
        return replace(
            self,
            precision=self.precision[:, columns][..., columns],
            columns=self.columns[..., columns],
            wanted=[rows[..., columns] for rows in self.wanted],
        )

    def information(self, stops: Int[Tensor, " stop"]) -> Float[Tensor, "draw coordinate coordinate"]:
        """What some stops add to the precision, each as often as it is named."""
        rows = self.columns[:, stops].flatten(1, 2)
        return rows.mT @ rows

    def widths(self, precision: Float[Tensor, "draw coordinate coordinate"]) -> Float[Tensor, "goal draw"]:
        """Half-width of the 90 % interval of each goal over its target; 1 is just reached."""
        return widths_of(self.wanted, self.widest, precision)


def widths_of(
    wanted: Sequence[Float[Tensor, "draw _ coordinate"]],
    widest: Sequence[bool],
    precision: Float[Tensor, "draw coordinate coordinate"],
) -> Float[Tensor, "goal draw"]:
    """Half-width of the 90 % interval of each goal over its target; 1 is just reached.

    Args:
        wanted, widest: As in `Expected`.
        precision: Of the coordinates.
    """
    covariance = torch.linalg.inv(precision)
    widths = [covariance.new_zeros(0, len(covariance))]
    for rows, is_widest in zip(wanted, widest, strict=True):
        variance = ((rows @ covariance) * rows).sum(-1)
        widths.append((variance.amax(-1) if is_widest else variance.mean(-1)).sqrt()[None])
    return torch.cat(widths)


def known_coordinates(coordinates: Coordinates) -> Int[Tensor, " coordinate"]:
    """Columns of the coordinates that are not noise."""
    return torch.tensor([i for i, name in enumerate(coordinates.names) if not name.endswith(".noise_T")])


def draws_of_prior(rig: Rig, n: int, seed: int) -> Float[Tensor, "draw all"]:
    """Draws of the prior that are possible rigs, as coordinates; fewer where the prior allows few.

    Raises:
        InvalidInput: The rig has no free parameter, or its priors allow next to no possible rig.
    """
    coordinates = Coordinates(rig)
    if not len(known_coordinates(coordinates)):
        raise InvalidInput(
            f"rig must have at least one free parameter (a prior) to plan for; rig {rig.name!r} has none"
        )
    draws = coordinates.sample_prior(np.random.default_rng(seed), 4 * n)
    values = coordinates.values(draws)
    possible = [
        rig.with_values({name: float(values[name][i]) for name in coordinates.names}).broken_rule() is None
        for i in range(len(draws))
    ]
    draws = draws[torch.tensor(possible)][:n]
    if len(draws) < min(n, 4):
        raise InvalidInput(
            f"priors of rig {rig.name!r} must allow possible rigs; of {4 * n} draws {len(draws)} are"
        )
    return draws


def is_clear(rig: Rig, stops: Observations, at: Float[Tensor, "draw all"]) -> Bool[Tensor, " reading"]:
    """Whether each sensor stays outside every winding at the nominal values and at all draws.

    Args:
        rig: Bodies and movers.
        stops: Readings to judge.
        at: Coordinates of the draws.
    """
    model, coordinates = MeasurementModel.unruled(rig, stops), Coordinates(rig)
    vectors = torch.cat((coordinates.start()[None], at))
    distances_m = clearance_m(model, coordinates.values(vectors))
    return (distances_m.reshape(-1, len(stops)) > 0.0).all(0)


def refuse_unreachable(expected: Expected, goals: Sequence[Goal]) -> None:
    """Refuse goals that a hundred visits to every candidate do not reach: what the prior leaves open they hardly see.

    Raises:
        InvalidInput: There is one; the sentence says what would be reached.
    """
    if not goals:
        return
    everything = expected.information(torch.arange(expected.n_stops))
    precision = expected.precision + MOST_VISITS * everything
    floors = expected.widths(precision).median(-1).values
    for goal, rows, floor in zip(goals, expected.wanted, floors.tolist(), strict=True):
        if floor > 1.0:
            each = ((rows @ torch.linalg.inv(precision)) * rows).sum(-1).sqrt().median(0).values
            beyond = [name for name, width in zip(goal.names, each.tolist(), strict=False) if width > 1.0]
            whose = f" of {', '.join(beyond)}, which they hardly see or cannot tell apart" if beyond else ""
            raise InvalidInput(
                f"goal {goal.text!r} must be within reach of the candidate stops; {MOST_VISITS} visits to each of them would leave "
                f"{floor:.2g} times its half-width{whose}. Give other places or currents, or free fewer parameters of the rig"
            )
