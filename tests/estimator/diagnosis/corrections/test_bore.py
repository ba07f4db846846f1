"""Corrections along a bore: the cylinder about the places, which places determine how much, and when the room's field can be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Circumstances
from estimator.effects.corrections.correction import Correction
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text


def bore_m(n: int, length_m: float = 1.2, radius_m: float = 0.1) -> Tensor:
    """Places in a cylinder about the diagonal of x and z."""
    rng = np.random.default_rng(4)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, n), radius_m * np.sqrt(rng.uniform(0.0, 1.0, n))
    along = length_m * np.linspace(-0.5, 0.5, n)
    z, x, y = np.array([0.6, 0.0, 0.8]), np.array([0.8, 0.0, -0.6]), np.array([0.0, 1.0, 0.0])
    places_m = along[:, None] * z + (r * np.cos(angle))[:, None] * x + (r * np.sin(angle))[:, None] * y
    return torch.from_numpy(places_m + np.array([0.3, -0.2, 0.1]))


def test_cylinder_lies_about_the_places_along_their_widest_extent():
    cylinder = EFFECTS["room_bore"].around(bore_m(500))
    middle_m = [cylinder[f"middle_{axis}_m"] for axis in "xyz"]
    np.testing.assert_allclose(middle_m, [0.3, -0.2, 0.1], atol=0.02)
    assert cylinder["along_x"] == pytest.approx(0.6, abs=0.02)
    assert cylinder["along_y"] == pytest.approx(0.0, abs=0.02)
    assert 0.1 < cylinder["radius_m"] < 0.13
    assert cylinder["length_m"] == pytest.approx(1.2 + 5.0 * cylinder["radius_m"], rel=0.02)


@pytest.mark.parametrize(
    ("places_m", "degree", "words"),
    [
        (bore_m(500), 24, ""),
        (bore_m(40), 2, "measure at 47"),
        (bore_m(500, length_m=0.42), 22, ""),  # steeper waves would be nothing on the axis
        (bore_m(500, length_m=0.3), -1, ""),  # a ball does as well
        (bore_m(90, radius_m=0.0), -1, "measure beside it"),
    ],
)
def test_places_limit_the_number_of_waves(places_m, degree, words):
    limit = EFFECTS["room_bore"].limit_around(places_m)
    assert limit.degree == degree
    assert words in limit.words


def test_uncertainty_of_the_prior_comes_back_beyond_the_ends():
    """Amplitudes fitted to places along the z axis with noise of a thirtieth of their width; half waves that end there would be mirrored."""
    places_m = torch.rand(200, 3, generator=torch.Generator().manual_seed(1)).double()
    places_m = (places_m - 0.5) * torch.tensor([0.14, 0.14, 0.8])
    effect, cylinder = EFFECTS["room_bore"], EFFECTS["room_bore"].around(places_m)
    keys = [effect.key(degree, term) for degree in range(13) for term in effect.terms(degree)]
    theta = dict(zip(keys, torch.eye(len(keys)).double(), strict=True))
    theta |= {key: torch.tensor(value).double() for key, value in cylinder.items()}

    def design(points_m: Tensor) -> Tensor:
        return effect.field(points_m, theta).flatten(1).T

    precision = torch.eye(len(keys)).double() + 1e3 * design(places_m).T @ design(places_m)
    heights_m = torch.tensor([0.3, 0.4 + 2.5 * cylinder["radius_m"]]).double()
    asked = design(torch.stack((0.0 * heights_m, 0.0 * heights_m, heights_m), dim=1))
    sd = (asked @ torch.linalg.inv(precision) * asked).sum(1).sqrt() / asked.square().sum(1).sqrt()
    inside, beyond = sd.split(3)
    assert float(inside.max()) < 0.01
    assert float(beyond.min()) > 0.3


def test_field_of_the_room_is_told_where_no_coil_carried_current(small_session):
    text = rig_text(small_session.rig).replace("    carried_by: arm1\n", "")
    text = text.replace("world_from_coil0", "world_from_coil").replace("hall: {", "hall: {carried_by: arm1, ")
    rig, observations = rig_from_text(text), small_session.observations
    off = replace(observations, current_A=torch.zeros_like(observations.current_A), whole=None, chosen=None)
    for name in ("room_harmonics", "room_bore"):
        effect = EFFECTS[name]
        assert isinstance(effect, Correction)
        assert "measure without current" in effect.limit(Circumstances(rig, observations), "room").words
        assert effect.limit(Circumstances(rig, off), "room").words == ""
