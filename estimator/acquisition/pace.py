"""Prepares a run of a plan: its stops in order, the instruments that it needs, and how long it takes."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.geometry.motion import flange_to_reach
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, observations_of
from estimator.rig.rig import Rig

# Estimates until measured: duration of a reading, and of a motion besides its travel time.
READING_S, MOTION_S = 0.02, 0.3

SPEED_M_PER_S = 0.1  # of an arm whose limits are not known

ANSWER_S = 5.0
"""Time to allow an instrument beyond the duration of a ramp, motion or measurement."""

SETTLED_SIGMA = 4.0
"""Allowed difference of the two halves of the readings, in standard errors; chance exceeds it at one or two stops in a hundred."""

FEWEST_READINGS = 6
"""Number of readings from which on their halves reveal a field that still changes, however small the noise.

A field that changes by b from reading to reading makes the halves of n readings differ by n b / 2. It also raises their scatter from
successive differences to b / sqrt(2), which allows a difference of SETTLED_SIGMA 2 / sqrt(n) times as much: more than n b / 2 until
n^(3/2) exceeds 8 sqrt(2).
"""


@dataclass(frozen=True)
class Pace:
    """Times, speeds and number of readings of a run.

    Attributes:
        settle_s: Time between the last command and the first reading.
        n_readings: Number of readings averaged at a stop, at least `FEWEST_READINGS`.
        longest_settle_s: Time after which a field that still changes is averaged as it is, and marked so.
        speed_m_per_s: Speed of each arm.
        slew_A_per_s: Ramp rate of each supply.
    """

    settle_s: float
    n_readings: int
    longest_settle_s: float
    speed_m_per_s: Mapping[str, float]
    slew_A_per_s: Mapping[str, float]

    def at_rest_s(self, rig: Rig) -> float:
        """Expected time at a stop after its travel and its ramps."""
        return self.settle_s + self.n_readings * READING_S * len(rig.sensors)

    def __post_init__(self) -> None:
        if self.n_readings < FEWEST_READINGS:
            raise InvalidInput(
                f"pace.n_readings must be at least {FEWEST_READINGS} to tell whether the field has settled; received {self.n_readings}"
            )


def default_pace(rig: Rig, settle_s: float) -> Pace:
    """Pace of a rig whose limits are not known."""
    return Pace(settle_s, 10, 10.0, {m.name: SPEED_M_PER_S for m in rig.movers}, {})


def stops_of(plan: Plan, rig: Rig, seed: int) -> Observations:
    """The stops of a plan in the order of the visit, one row each for any number of sensors.

    Args:
        plan: Poses and currents.
        rig: The rig of the plan.
        seed: Seed of a random order; the same seed gives the same order.
    """
    readings = observations_of(plan, rig, np.random.default_rng(seed))
    return readings.rows(torch.arange(0, len(readings), len(rig.sensors)))


def digest_of(stops: Observations) -> str:
    """SHA-256 of the stops of a run; an interrupted run may continue only with the same stops."""
    tensors = [stops.current_A, *stops.motion.values(), stops.is_validation.double(), stops.repeat.double()]
    return hashlib.sha256(b"".join(tensor.numpy().tobytes() for tensor in tensors)).hexdigest()


def check_instruments(stops: Observations, rig: Rig, names: Mapping[str, set[str]]) -> None:
    """Refuse a plan that needs a missing instrument.

    Args:
        stops: Stops to visit.
        rig: The rig to measure.
        names: Names of the devices, by `sensors`, `sources` and `arms`.
    Raises:
        InvalidInput: A coil that is to carry a current has no supply, a mover has no arm, or there is no sensor.
    """
    driven = {coil.name for i, coil in enumerate(rig.coils) if bool((stops.current_A[:, i] != 0.0).any())}
    moved = {mover.name for mover in rig.movers}
    for kind, needed in (("sources", driven), ("arms", moved)):
        missing = sorted(needed - names[kind])
        if missing:
            raise InvalidInput(f"devices must have one for {missing[0]}, which the plan uses; there is none")
    if not names["sensors"]:
        raise InvalidInput("devices must have a sensor; there is none")


def durations_s(stops: Observations, rig: Rig, pace: Pace) -> list[float]:
    """Expected duration of each stop, from its travel, its ramps and its readings.

    The travel to the first stop is unknown and counts as zero.
    """
    rows = torch.arange(len(stops))
    first_s = MOTION_S * len(rig.movers)
    for i, coil in enumerate(rig.coils):
        if coil.name in pace.slew_A_per_s and len(stops):
            first_s += abs(float(stops.current_A[0, i])) / pace.slew_A_per_s[coil.name]
    ways_s = [first_s, *ways_between_s(stops, rig, pace, rows[:-1], rows[1:]).tolist()]
    return [pace.at_rest_s(rig) + way_s for way_s in ways_s[: len(stops)]]


def ways_between_s(
    stops: Observations, rig: Rig, pace: Pace, before: Int[Tensor, "*#way"], after: Int[Tensor, "*#way"]
) -> Float[Tensor, "*way"]:
    """Expected duration of travel and ramps from some stops to others.

    Args:
        stops: One row each.
        rig: Names movers and coils.
        pace: Speeds of the arms and ramp rates of the supplies.
        before, after: Numbers of the stops at both ends of each way.
    """
    total_s = torch.zeros(np.broadcast_shapes(before.shape, after.shape), dtype=torch.float64)
    for mover in rig.movers:
        motion = stops.motion[mover.name]
        flange_m = flange_to_reach(mover, motion, Transform.identity()).translation_m
        way_s = MOTION_S + (flange_m[after] - flange_m[before]).norm(dim=-1) / pace.speed_m_per_s[mover.name]
        total_s = total_s + torch.where((motion[after] != motion[before]).any(-1), way_s, 0.0)
    for i, coil in enumerate(rig.coils):
        if coil.name in pace.slew_A_per_s:
            change_A = (stops.current_A[after, i] - stops.current_A[before, i]).abs()
            total_s = total_s + change_A / pace.slew_A_per_s[coil.name]
    return total_s
