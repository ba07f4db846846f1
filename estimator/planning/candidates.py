"""Stops among which a plan chooses: poses and currents of a plan file, or of the spans and currents that the limits of a rig allow."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from estimator.effects.everywhere import with_everywhere
from estimator.errors import InvalidInput
from estimator.planning.causes import with_causes
from estimator.planning.information import N_DRAWS, draws_of_prior, is_clear
from estimator.readings.halton import halton
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, observations_of
from estimator.readings.protocol import recommended_currents_A
from estimator.readings.split import some_distinct
from estimator.rig.bodies import MotionKind
from estimator.rig.rig import Rig

MOST_CANDIDATES = 2000  # stops; more are thinned at random, for which the criterion hardly changes
MOST_ENDS = 64  # corners of the spans of two movers
N_PLACES = 300  # that fill a span where no plan lists any


def places_within(rig: Rig, spans_m: Mapping[str, np.ndarray], largest_A: Mapping[str, float]) -> Plan:
    """A plan whose places fill the span of each mover evenly, with the recommended currents.

    Args:
        rig: With movers that report displacements.
        spans_m: Lower and upper displacement along x, y and z, by mover.
        largest_A: Of each coil.
    Raises:
        InvalidInput: A mover is told by joints or whole poses, of which no span follows from a workspace, or has no span.
    """
    for mover in rig.movers:
        if mover.motion is not MotionKind.DISPLACEMENT or mover.name not in spans_m:
            raise InvalidInput(
                f"places must be given by a plan file where a mover is told by joints or poses, or has no workspace; {mover.name} of rig "
                f"{rig.name!r} is one: give PLAN after RIG"
            )
    n_axes = 3 * len(rig.movers)
    ends = np.array(list(itertools.product((0.0, 0.5, 1.0) if n_axes <= 3 else (0.0, 1.0), repeat=n_axes)))
    points = np.concatenate((ends[:MOST_ENDS], halton(n_axes, N_PLACES + 1)[1:]))  # ends inform most
    poses = []
    for point in points if rig.movers else points[:1]:
        pose = {}
        for i, mover in enumerate(rig.movers):
            low_m, high_m = spans_m[mover.name]
            pose[mover.name] = np.concatenate(
                (low_m + point[3 * i : 3 * i + 3] * (high_m - low_m), np.zeros(3))
            )
        poses.append(pose)
    return Plan("places", tuple(poses), (), recommended_currents_A(largest_A), "raster", 1, 1.0)


def candidates_of(places: Plan, rig: Rig, seed: int) -> Observations:
    """Distinct stops of a plan file, those for validation too, in a random order; a row for each sensor.

    Args:
        places: Poses and currents.
        rig: Of the plan.
        seed: Of the order, and of which stops stay where there are too many.
    """
    readings = observations_of(places, rig, np.random.default_rng(seed))
    n_sensors = len(rig.sensors)
    rows = torch.arange(0, len(readings), n_sensors)
    key = torch.cat([readings.current_A, *readings.motion.values()], dim=1)[rows]
    chosen = rows_of(some_distinct(key, MOST_CANDIDATES, torch.Generator().manual_seed(seed)), n_sensors)
    motion = {name: columns[chosen] for name, columns in readings.motion.items()}
    return Observations.of(readings.current_A[chosen], motion, sensor=readings.sensor[chosen])


def rows_of(stops: Tensor, n_sensors: int) -> Tensor:
    """Rows of the readings of some stops, sensor by sensor.

    Examples:
        >>> rows_of(torch.tensor([2, 0]), 2)
        tensor([4, 5, 0, 1])
    """
    return (stops[:, None] * n_sensors + torch.arange(n_sensors)).flatten()


def clear_candidates(places: Plan, rig: Rig, seed: int) -> Observations:
    """Stops of a plan file at which no sensor would stand in a winding, whatever the prior allows."""
    return possible(candidates_of(places, rig, seed), rig, draws_of_prior(rig, N_DRAWS, seed))


def largest_currents_A(rig: Rig, stops: Observations) -> dict[str, float]:
    """Largest current of each coil among some stops."""
    return {coil.name: float(stops.current_A[:, i].abs().max()) for i, coil in enumerate(rig.coils)}


def one_row_each(stops: Observations, rig: Rig) -> Observations:
    """The first sensor's row of each stop, as a session of its own."""
    return stops.rows(torch.arange(0, len(stops), len(rig.sensors))).alone


def possible(stops: Observations, rig: Rig, at: Tensor) -> Observations:
    """The stops at which no sensor would stand in a winding, at the nominal values and at draws of the prior.

    Raises:
        InvalidInput: There are fewer numbers to read than free parameters.
    """
    n_sensors = len(rig.sensors)
    clear = is_clear(rig, stops, at).reshape(-1, n_sensors).all(-1)
    left = stops.rows(rows_of(clear.nonzero().flatten(), n_sensors)).alone
    n_unknown = at.shape[1]
    if 3 * len(left) < n_unknown:
        n_stops = len(stops) // n_sensors
        raise InvalidInput(
            f"candidate stops must give at least as many numbers as the rig has unknowns, {n_unknown}; {3 * len(left)} numbers come from "
            f"{len(left) // n_sensors} stops ({n_stops - int(clear.sum())} of {n_stops} may lie in a winding)"
        )
    return left


def fitted_rig(rig: Rig, stops: Observations, goals: Sequence[str]) -> Rig:
    """The rig that a calibration of such stops fits, with the causes that goals name.

    It has what no laboratory is without, where the stops can tell it.
    """
    return with_causes(with_everywhere(rig, stops).rig, stops, goals)
