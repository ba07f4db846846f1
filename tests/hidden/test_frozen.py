"""A seed means the session that it meant, for studies are compared from one year to the next; no size of a cause is no flaw."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tests.hidden.flaw import Flaw
from tests.hidden.frozen import EVERY_KIND, FILE, Frozen, of_cause, of_kind, scenes_of
from tests.hidden.library import ALL
from tests.hidden.visible_size import effect_T

FROZEN = json.loads(FILE.read_text(encoding="utf-8"))


def check(name: str, now: Frozen) -> None:
    """Nine digits are written; another processor rounds otherwise."""
    assert now[1] == FROZEN[name][1]
    np.testing.assert_allclose(now[0], FROZEN[name][0], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("cause", ALL.values(), ids=lambda cause: cause.name)
def test_a_cause_does_what_it_did(cause, sessions):
    check(cause.name, of_cause(cause, sessions))


@pytest.mark.parametrize("kind", EVERY_KIND)
def test_a_session_of_a_kind_is_what_it_was(kind):
    check(f"kind {kind}", of_kind(kind))


@pytest.mark.parametrize("cause", ALL.values(), ids=lambda cause: cause.name)
def test_no_size_is_no_flaw(cause, sessions):
    for scene in scenes_of(cause, sessions):
        assert np.abs(effect_T(scene, [Flaw(cause, 0.0, 3)])).max() < 1e-15
