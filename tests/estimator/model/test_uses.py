"""Which effects a rig has, and their numbers among all others."""

from __future__ import annotations

import pytest
import torch

from estimator.effects.attach import with_effect
from estimator.effects.stages import MountEffect, ReadingEffect
from estimator.effects.use import Use, uses_of
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session

GAIN, MOVED = Cause("axis_gain", "hall"), Cause("sensor_misplaced", "hall")


@pytest.fixture
def rig(small_rig: Rig, small_session: Session) -> Rig:
    readings = small_session.observations
    return with_effect(with_effect(small_rig, GAIN, readings, {}), MOVED, readings, {})


def test_effects_of_a_stage_are_those_of_the_rig_that_is_asked(rig: Rig) -> None:
    (gain,) = uses_of(rig, ReadingEffect)
    assert gain.cause == GAIN
    assert [use.cause for use in uses_of(rig, MountEffect, "hall")] == [MOVED]
    assert uses_of(rig, MountEffect, "elsewhere") == ()
    assert uses_of(rig.without_cause(GAIN), ReadingEffect) == ()


def test_numbers_of_a_use_are_those_with_its_label(rig: Rig) -> None:
    values = {name: torch.tensor(value) for name, value in rig.nominal_values().items()}
    for use in (*uses_of(rig, ReadingEffect), *uses_of(rig, MountEffect)):
        prefix = f"{use.label}."
        own = {name.removeprefix(prefix): v for name, v in values.items() if name.startswith(prefix)}
        assert own
        assert use.theta(values) == Use(use.effect, use.place).theta(values) == own
        assert use.keys(rig) == tuple(own)


def test_numbers_of_a_use_share_their_batch(rig: Rig) -> None:
    (gain,) = uses_of(rig, ReadingEffect)
    values = {name: torch.tensor(value) for name, value in rig.nominal_values().items()}
    first = next(iter(gain.keys(rig)))
    values[f"{gain.label}.{first}"] = torch.zeros(5)
    assert {value.shape for value in gain.theta(values).values()} == {(5,)}
