"""How large an error a wrong model may make at a reading, by the errors beside it: a rival of every mistake of single rows.

What a model lacks, such as iron, changes a field smoothly with place and current. So its error at one reading is near what those of the
neighbours lead to expect, and of the size that they have. A row that was written down wrongly stands alone among its neighbours.
"""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree
from torch import Tensor

from estimator.diagnosis import policy
from estimator.diagnosis.expectation import SD_OF_MEDIAN, Expectation
from estimator.readings.flags import in_time
from estimator.readings.observations import Observations

NEIGHBOURS = 12  # readings beside one, whose errors tell what a wrong model does there
FEWEST_NEIGHBOURS = 5
LENGTHS = (1.0, 5.0)  # over which errors may change, in distances of the farthest neighbour
ROUGHNESSES = (1e-4, 1e-1)  # variance of what does not follow the settings, over that of what does
N_WAYS = 2 + len(LENGTHS) * len(ROUGHNESSES)  # in which errors of a wrong model may lie
MOST_OFF = 10.0  # of a neighbour's error from their median, in median distances from that
MOST_OF_A_STOP = 36  # readings of one stop that are passed over in search of others
# A reading is of the same stop as the one before up to this change of every setting, over its range
SAME_STOP = 1e-4
ROWS_AT_ONCE = 20_000
LEAST_DISTANCE = 1e-9  # of settings, over their ranges
LEAST_T = 1e-12  # size of errors, where a model has none

Settings = npt.NDArray[np.float64]


def log_density_of_wrong_model(expected: Expectation) -> Float[Tensor, " reading"]:
    """Log density of each reading's field, per T of every measured component, where a wrong model makes the errors.

    They are those of Student's t, either about zero and as wide as the errors of the neighbours are large, or about what these lead to
    expect, in one of several ways, and as wide as that is usually off: the mean of the densities.

    Args:
        expected: Of the readings.
    """
    observations = expected.observations
    errors_T = observations.field_sensor_T - expected.predicted_T
    by_way = errors_T.new_zeros(N_WAYS, len(errors_T))
    for sensor in observations.sensor.unique().tolist():
        in_order = in_time(observations, sensor)
        alike: dict[tuple[int, ...], list[int]] = {}
        for axis in range(3):
            rows = in_order[~errors_T[in_order, axis].isnan()]
            if len(rows):
                alike.setdefault(tuple(rows.tolist()), []).append(axis)
        for numbers, axes in alike.items():
            own = in_order.new_tensor(numbers)
            own_T, size_T = errors_T[own][:, axes], expected.size_T[own, None].expand(-1, len(axes))
            by_way[:, own] += _log_densities(_settings(observations, own), own_T, size_T)
    return torch.logsumexp(by_way, dim=0) - math.log(N_WAYS)


def _log_densities(
    settings: Settings, own_T: Float[Tensor, "own axis"], size_T: Float[Tensor, "own axis"]
) -> Float[Tensor, "way own"]:
    """Log density of errors of some axes in each way, by neighbours in which the same axes were measured."""
    if len(own_T) <= FEWEST_NEIGHBOURS:
        return _log_density(own_T, size_T).expand(N_WAYS, -1)
    neighbours = _Neighbours.of(torch.from_numpy(settings).to(own_T))
    widest_T = torch.maximum(SD_OF_MEDIAN * neighbours.median(own_T.abs()), size_T)
    densities = [_log_density(own_T, size_T), _log_density(own_T, widest_T)]
    for length, roughness in product(LENGTHS, ROUGHNESSES):
        off_T = own_T - neighbours.kriged(own_T, length, roughness)
        least_T = 0.5 * off_T.abs().median(dim=0).values.clamp(min=LEAST_T)
        wide_T = SD_OF_MEDIAN * torch.maximum(neighbours.median(off_T.abs()), least_T)
        densities.append(_log_density(off_T, wide_T))
    return torch.stack(densities)


def _log_density(
    error_T: Float[Tensor, "own axis"], scale_T: Float[Tensor, "own axis"]
) -> Float[Tensor, " own"]:
    density = torch.distributions.StudentT(policy.DEGREES_OF_ERRORS, 0.0, scale_T).log_prob(error_T)
    return density.sum(dim=1)


def _settings(observations: Observations, own: Int[Tensor, " own"]) -> Settings:
    """Currents and poses of a sensor's readings over their ranges, without what never changes."""
    columns = torch.cat([observations.current_A, *observations.motion.values()], dim=1)[own].cpu().numpy()
    ranges = np.ptp(columns, axis=0)
    scaled: Settings = columns[:, ranges > 0.0] / ranges[ranges > 0.0]
    return scaled if scaled.shape[1] else np.zeros((len(columns), 1))


class _Neighbours(NamedTuple):
    """Readings of a sensor with the nearest settings, but for those of the same stop, which share what went wrong there.

    Attributes:
        at: Settings of all readings of the sensor.
        rows: Numbers of each reading's neighbours.
        counts: Whether each is one, of another stop.
    """

    at: Float[Tensor, "reading setting"]
    rows: Int[Tensor, "reading neighbour"]
    counts: Bool[Tensor, "reading neighbour"]

    @classmethod
    def of(cls, at: Float[Tensor, "reading setting"]) -> _Neighbours:
        """Neighbours of readings with these settings, which are in order of time."""
        is_next = (at.diff(dim=0).abs() > SAME_STOP).any(dim=1)
        stop = torch.cat((torch.zeros(1, dtype=torch.int64), is_next.long().cumsum(dim=0)))
        n = min(len(at), NEIGHBOURS + min(int(stop.bincount().max()), MOST_OF_A_STOP))
        nearest = torch.from_numpy(KDTree(at.cpu().numpy()).query(at.cpu().numpy(), n)[1]).reshape(len(at), n)
        is_other = stop[nearest] != stop[:, None]
        order = (~is_other).long().argsort(dim=1, stable=True)[:, :NEIGHBOURS]
        return cls(at, nearest.gather(1, order), is_other.gather(1, order))

    def kriged(
        self, error_T: Float[Tensor, "reading axis"], length: float, roughness: float
    ) -> Float[Tensor, "reading axis"]:
        """Error of each reading by those of its neighbours, for a Gaussian process of mean zero that is smooth in the settings.

        Args:
            error_T: Errors of all readings of the sensor.
            length: Over which they change, in distances of the farthest neighbour.
            roughness: Variance of what does not follow the settings, over that of what does.
        References: Matern's kernel of order 3/2; Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), sections 2.2, 4.2.
        """
        parts = torch.arange(len(error_T)).split(ROWS_AT_ONCE)
        return torch.cat([self._kriged(error_T, part, length, roughness) for part in parts])

    def _kriged(
        self,
        error_T: Float[Tensor, "reading axis"],
        rows: Int[Tensor, " row"],
        length: float,
        roughness: float,
    ) -> Float[Tensor, "row axis"]:
        neighbours, counts = self.rows[rows], self.counts[rows]
        there, here = self.at[neighbours], self.at[rows][:, None]
        to_here = torch.cdist(there, here) * counts[:, :, None]
        scale = length * to_here.amax(dim=1, keepdim=True).clamp(min=LEAST_DISTANCE)
        between = _matern(torch.cdist(there, there) / scale) * (counts[:, :, None] & counts[:, None])
        between = between + torch.diag_embed(torch.where(counts, roughness, 1.0).to(between))
        weights = torch.linalg.solve(between, _matern(to_here / scale) * counts[:, :, None])
        return (weights * _limited(error_T[neighbours])).sum(dim=1)

    def median(self, size_T: Float[Tensor, "reading axis"]) -> Float[Tensor, "reading axis"]:
        """Median size at the neighbours of each reading; 0 where it has none."""
        beside_T = size_T[self.rows].masked_fill(~self.counts[:, :, None], torch.nan)
        return beside_T.nanmedian(dim=1).values.nan_to_num(0.0)


def _limited(error_T: Float[Tensor, "row neighbour axis"]) -> Float[Tensor, "row neighbour axis"]:
    """Errors of neighbours without those that are far from the others: rows that are wrong themselves."""
    middle_T = error_T.median(dim=1, keepdim=True).values
    most_T = MOST_OFF * (error_T - middle_T).abs().median(dim=1, keepdim=True).values
    return error_T.clamp(middle_T - most_T, middle_T + most_T)


def _matern(distance: Tensor) -> Tensor:
    scaled = math.sqrt(3.0) * distance
    return (1.0 + scaled) * torch.exp(-scaled)
