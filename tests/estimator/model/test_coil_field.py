"""Coils of every kind give their field alike, and say where they have none."""

from __future__ import annotations

import pytest
import torch

from estimator.errors import InvalidInput
from estimator.field.winding_shape import Rule
from estimator.model.coil_field import coil_field, refuse
from estimator.rig.coordinates import nominal_tensors
from estimator.rig_files.read import rig_from_text

LOOPS = "wire_radius_mm: 0.5, axial_loops: 8, radial_loops: 4"
AMPLITUDES = "reference_radius_mm: 30, amplitudes: {sd_T_per_A: 1e-3}"
KINDS = {
    "round": f"radius_mm: 40, {LOOPS}",
    "literal": f"radius_mm: 40, {LOOPS}, field_sum: spherical_components",
    "rectangular": f"model: rectangular, inner_side_x_mm: 60, inner_side_y_mm: 40, {LOOPS}",
    "interior": f"model: harmonic, region: interior, degree: 2, {AMPLITUDES}",
    "exterior": f"model: harmonic, region: exterior, degree: 2, {AMPLITUDES}",
    "charges": "model: equivalent_sources, half_x_mm: 30, half_y_mm: 30, half_z_mm: 30, margin_mm: 20, spacing_mm: 20, amplitudes: {sd_T_per_A: 1e-3}",
}
RIG = "schema_version: 1\nname: one\ncoils: {{coil: {{{}}}}}\nsensors: {{hall: {{noise_uT: 5}}}}\n"
SPOT_M = {"exterior": (0.05, 0.02, 0.06)}
FORBIDDEN_M = {
    "round": (0.038, 0.0, -0.004),
    "literal": (0.038, 0.0, -0.004),
    "rectangular": (0.032, 0.0, -0.004),
    "exterior": (0.0, 0.01, 0.01),
    "charges": (0.0, 0.0, 0.045),
}


def field_of(kind: str, scale: float = 1.0):
    rig = rig_from_text(RIG.format(KINDS[kind]))
    names = {name for coil in rig.unwound for own in coil.amplitudes.values() for name in own}
    values = nominal_tensors(rig)
    for i, name in enumerate(sorted(names)):
        values[name] = scale * torch.tensor(1e-3 * (1.0 + 0.1 * i), dtype=torch.float64)
    return coil_field(rig, rig.coils[0], values), rig


@pytest.mark.parametrize("kind", KINDS)
def test_field_has_neither_divergence_nor_curl_where_it_is_there(kind):
    field, rig = field_of(kind)
    point_m = torch.tensor([SPOT_M.get(kind, (0.01, -0.005, 0.02))], dtype=torch.float64)
    assert not field.has_none(point_m).any()
    assert not any(is_refused.any() for _, is_refused in field.rules(point_m))
    assert (field.winding is not None) == rig.coils[0].is_wound
    assert field.has_zones == (kind in ("round", "rectangular"))
    per_ampere = field.by(Rule(8, 4, 8))
    slope = torch.autograd.functional.jacobian(lambda at_m: per_ampere(at_m[None])[0], point_m[0])
    if kind != "literal":  # the paper's sum is no magnetic field
        assert float((slope - slope.mT).abs().max()) < 1e-8 * float(slope.abs().max())
        assert abs(float(slope.trace())) < 1e-8 * float(slope.abs().max())


@pytest.mark.parametrize("kind", FORBIDDEN_M)
def test_sensor_is_refused_where_a_coil_has_no_field(kind):
    field, _ = field_of(kind)
    points_m = torch.tensor([SPOT_M.get(kind, (0.01, -0.005, 0.02)), FORBIDDEN_M[kind]], dtype=torch.float64)
    assert field.has_none(points_m).tolist() == [False, True]
    rows, pose_row = torch.tensor([3, 5]), torch.tensor([3, 3, 5, 5])
    rules, line = field.rules(points_m), torch.tensor([10, 11, 13, 14])
    with pytest.raises(
        InvalidInput, match=r"1 of 2 poses do not, the first at reading 2: correct where .* \(rig 'one'\)"
    ):
        refuse(rules, rows, pose_row, None, "one", True)
    with pytest.raises(InvalidInput, match="1 of 2 poses do not, the first in line 13: "):
        refuse(rules, rows, pose_row, line, "one", True)


@pytest.mark.parametrize("kind", ["interior", "exterior", "charges"])
def test_field_without_a_winding_is_linear_in_its_amplitudes(kind):
    point_m = torch.tensor([SPOT_M.get(kind, (0.01, -0.005, 0.02))], dtype=torch.float64)
    once, thrice = (field_of(kind, scale)[0].by(None)(point_m) for scale in (1.0, 3.0))
    torch.testing.assert_close(thrice, 3.0 * once, rtol=1e-12, atol=0.0)
