"""Currents that are commanded in turn repeat in a cycle, whose time is found; others have none."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
import torch

from estimator.readings.cycles import cycle_of_currents_s, is_of_cycle
from estimator.readings.observations import Observations

STEP_S = 2.0


def readings(
    current_A: Sequence[float], time_s: Sequence[float] | None = None, n_sensors: int = 1
) -> Observations:
    """One reading a step, by each of some sensors."""
    current = torch.tensor(current_A, dtype=torch.float64).repeat_interleave(n_sensors)
    times = STEP_S * torch.arange(len(current_A)) if time_s is None else torch.tensor(time_s)
    return Observations.of(
        current[:, None],
        time_s=times.double().repeat_interleave(n_sensors),
        sensor=torch.arange(n_sensors).repeat(len(current_A)),
    )


@pytest.mark.parametrize("cycle_A", [(1.0, 2.0, 3.0), (0.0, 1.5, 3.0, 1.5), (1.0, -1.0)])
@pytest.mark.parametrize("n_sensors", [1, 2])
def test_time_of_a_cycle_is_that_after_which_all_currents_come_again(cycle_A, n_sensors):
    expected_s = STEP_S * len(cycle_A)
    assert cycle_of_currents_s(readings(cycle_A * 12, n_sensors=n_sensors)) == expected_s
    part = readings(cycle_A * 12, n_sensors=n_sensors).rows(torch.arange(0, 9, 2))  # the history counts
    assert cycle_of_currents_s(part) == expected_s


def test_pauses_between_places_are_part_of_a_cycle():
    cycle_A, times_s = (1.0, 2.0, 3.0), [5.0 * place + i for place in range(10) for i in (0.0, 1.0, 2.0)]
    assert cycle_of_currents_s(readings(cycle_A * 10, times_s)) == 5.0


def test_one_current_and_currents_in_no_order_have_no_cycle():
    assert cycle_of_currents_s(readings((3.0,) * 30)) is None
    at_random = torch.randint(3, (60,), generator=torch.Generator().manual_seed(1)).double()
    assert cycle_of_currents_s(readings(at_random.tolist())) is None
    assert cycle_of_currents_s(readings((1.0, 2.0, 3.0) * 2)) is None  # seen twice only


def test_periods_are_told_from_a_cycle_as_well_as_the_session_tells_periods_apart():
    assert is_of_cycle(6.1, 6.0, 20.0)  # half a cycle per session lies 0.9 s away
    assert not is_of_cycle(6.5, 6.0, 2000.0)
    assert not is_of_cycle(6.0, None, 2000.0)
