"""What carrying out a plan takes: its stops in order, the instruments that it needs, and the time."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from estimator.errors import InvalidInput
from estimator.frames import Transform
from estimator.geometry.motion import flange_to_reach
from estimator.readings.observations import Observations
from estimator.readings.plan import Plan, observations_of
from estimator.rig.rig import Rig

READING_S, MOTION_S = (
    0.02,
    0.3,
)  # guesses of a reading and of what a motion takes besides its way, until it is measured

ANSWER_S = 5.0  # to allow an instrument beyond what a ramp, a motion or a measurement takes by itself

SETTLED_SIGMA = (
    4.0  # difference of the two halves of the readings that chance makes at one or two stops in a hundred
)

FEWEST_READINGS = 6
"""Of which the halves tell a field that still changes, however little noise there is.

A field that changes by b from reading to reading makes the halves of n readings differ by n b / 2. It also widens their scatter by
neighbours to b / sqrt(2), which allows a difference of SETTLED_SIGMA 2 / sqrt(n) times that: more than there is until n^(3/2) exceeds
8 sqrt(2).
"""


@dataclass(frozen=True)
class Pace:
    """How a plan is carried out.

    Attributes:
        settle_s: Time between the last command and the first reading.
        n_readings: That are averaged at a stop, `FEWEST_READINGS` at least.
        longest_settle_s: Time after which a field that still changes is taken as it is, and marked so.
        speed_m_per_s: Of each arm.
        slew_A_per_s: Of each supply.
    """

    settle_s: float
    n_readings: int
    longest_settle_s: float
    speed_m_per_s: Mapping[str, float]
    slew_A_per_s: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.n_readings < FEWEST_READINGS:
            raise InvalidInput(
                f"pace.n_readings must be at least {FEWEST_READINGS}, to tell whether the field has settled; received {self.n_readings}"
            )


def stops_of(plan: Plan, rig: Rig, seed: int) -> Observations:
    """The stops of a plan in the order of the visit, one row each, whatever the number of sensors.

    Args:
        plan: Poses and currents.
        rig: That it was made for.
        seed: Of the order, where that is random; the same one gives the same order again.
    """
    readings = observations_of(plan, rig, np.random.default_rng(seed))
    return readings.rows(torch.arange(0, len(readings), len(rig.sensors)))


def digest_of(stops: Observations) -> str:
    """What identifies the stops of a run: one that was interrupted may go on with the same ones only."""
    numbers = [stops.current_A, *stops.motion.values(), stops.is_validation.double(), stops.repeat.double()]
    return hashlib.sha256(b"".join(part.numpy().tobytes() for part in numbers)).hexdigest()


def check_instruments(stops: Observations, rig: Rig, names: Mapping[str, set[str]]) -> None:
    """Refuse a plan that needs an instrument which is not there.

    Args:
        stops: To be visited.
        rig: Names what must be served.
        names: Of the devices, by `sensors`, `sources` and `arms`.
    Raises:
        InvalidInput: A coil is to carry a current without a supply, a mover to move without an arm, or there is no sensor.
    """
    driven = {coil.name for i, coil in enumerate(rig.coils) if bool((stops.current_A[:, i] != 0.0).any())}
    moved = {mover.name for mover in rig.movers}
    for what, wanted in (("sources", driven), ("arms", moved)):
        missing = sorted(wanted - names[what])
        if missing:
            raise InvalidInput(f"devices must have one for {missing[0]}, which the plan uses; there is none")
    if not names["sensors"]:
        raise InvalidInput("devices must have a sensor; there is none")


def durations_s(stops: Observations, rig: Rig, pace: Pace) -> list[float]:
    """Time that each stop will take, by its way, its ramps and its readings.

    The way to the first stop is not known; it counts as none.
    """
    found = []
    nowhere = Transform.identity()
    targets = {m.name: flange_to_reach(m, stops.motion[m.name], nowhere).translation_m for m in rig.movers}
    for row in range(len(stops)):
        before = max(row - 1, 0)
        total_s = pace.settle_s + pace.n_readings * READING_S * len(rig.sensors)
        for mover in rig.movers:
            if row == 0 or bool((stops.motion[mover.name][row] != stops.motion[mover.name][before]).any()):
                way_m = float((targets[mover.name][row] - targets[mover.name][before]).norm())
                total_s += MOTION_S + way_m / pace.speed_m_per_s[mover.name]
        for i, coil in enumerate(rig.coils):
            if coil.name in pace.slew_A_per_s:
                from_A = float(stops.current_A[before, i]) if row else 0.0
                total_s += abs(float(stops.current_A[row, i]) - from_A) / pace.slew_A_per_s[coil.name]
        found.append(total_s)
    return found
