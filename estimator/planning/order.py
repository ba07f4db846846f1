"""The order in which stops are visited: a short tour, or a random one where drift shall be told from place."""

from __future__ import annotations

import networkx as nx
import numpy as np
import torch

from estimator.acquisition.pace import Pace, ways_between_s
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig

MOST_MATCHED = 150  # stops up to which Christofides' algorithm takes less than a second; the greedy tour is a tenth longer


def tour(stops: Observations, rig: Rig, pace: Pace) -> list[int]:
    """Numbers of stops in the order of a short way through all of them.

    Args:
        stops: One row each.
        rig: Names movers and coils.
        pace: Speeds of the arms and ramp rates of the supplies.

    References: Christofides, Report 388, Carnegie Mellon University (1976): at most 1.5 times the shortest tour.
    """
    n = len(stops)
    if n < 4:
        return list(range(n))
    rows = torch.arange(n)
    ways_s = ways_between_s(stops, rig, pace, rows[:, None], rows).numpy()
    graph = nx.from_numpy_array(ways_s + 1e-6 * (1.0 - np.eye(n)))  # a way of no length would be no edge
    solve = nx.approximation.christofides if n <= MOST_MATCHED else nx.approximation.greedy_tsp
    around: list[int] = solve(graph)[:-1]
    lengths_s = ways_s[around, np.roll(around, -1)]
    longest = int(lengths_s.argmax()) + 1  # no arm has to close the tour
    return around[longest:] + around[:longest]
