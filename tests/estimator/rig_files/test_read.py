"""Rig files: numbers arrive in SI, things hang together as written, and any other number gives another hash."""

from __future__ import annotations

import math

import pytest

from estimator.errors import InvalidInput
from estimator.rig.bodies import DisplacementFrame, MotionKind
from estimator.rig.parameters import LogNormal, Normal, Uniform
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig, rig_from_text


@pytest.fixture(scope="module")
def rig(two_coils_text: str) -> Rig:
    return rig_from_text(two_coils_text)


def changed(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1, old
    return text.replace(old, new)


def test_values_arrive_in_si(rig):
    values = rig.nominal_values()
    expected = {
        "coil1.radius_m": 0.048,
        "coil1.wire_radius_m": 0.00049,
        "coil1.world_from_coil0.z_m": -0.04,
        "coil2.radial_pitch_m": 0.0011,
        "arm2.world_from_base.x_m": 0.415,
        "arm2.world_from_base.spin_rad": math.pi,
        "hall.noise_T": 2e-5,
    }
    assert {name: values[name] for name in expected} == pytest.approx(expected, rel=1e-12)


def test_priors_arrive_in_si_and_keep_relative_widths(rig):
    priors = {parameter.name: parameter.prior for parameter in rig.free}
    assert list(priors) == [
        "coil1.radius_m",
        "coil1.axial_loops",
        "coil1.world_from_coil0.tilt_x_rad",
        "hall.noise_T",
    ]
    radius, loops, tilt, noise = priors.values()
    assert isinstance(radius, Normal)
    assert (radius.mean, radius.sd, radius.lower, radius.upper) == pytest.approx(
        (0.05, 0.003, 0.04, math.inf)
    )
    assert loops == Uniform(40.0, 50.0)
    assert tilt == Normal(0.0, 0.02)
    assert isinstance(noise, LogNormal)
    assert (noise.median, noise.relative_sd) == pytest.approx((2e-5, 0.5))


def test_a_prior_alone_says_where_the_fit_starts(rig):
    assert rig.nominal_values()["coil1.axial_loops"] == 45.0


def test_pitches_follow_the_wire_and_ties_their_factor(rig):
    values = rig.nominal_values()
    assert (
        values["coil1.axial_pitch_m"] == values["coil1.radial_pitch_m"] == 2 * values["coil1.wire_radius_m"]
    )
    assert values["coil2.radius_m"] == 1.5 * values["coil1.radius_m"]
    assert values["coil2.axial_loops"] == values["coil1.axial_loops"]
    assert "coil2.wire_radius_m" not in values


def test_movers_and_bodies_hang_together_as_written(rig):
    assert [(mover.name, mover.motion) for mover in rig.movers] == [
        ("arm1", MotionKind.DISPLACEMENT),
        ("arm2", MotionKind.UR3E),
    ]
    assert [(body.name, body.carried_by) for body in (*rig.coils, *rig.sensors)] == [
        ("coil1", "arm1"),
        ("coil2", "arm2"),
        ("hall", None),
    ]


def test_anchors_share_what_is_written_once(two_coils_text):
    text = changed(two_coils_text, "radial_loops: 22", "radial_loops: &loops 22").replace(
        "radial_loops: 30", "radial_loops: *loops"
    )
    assert rig_from_text(text).nominal_values()["coil2.radial_loops"] == 22.0


def test_displacements_in_the_base_frame_need_the_reference_rotation(two_coils_text):
    base = "{motion: displacement, displacement_frame: base"
    mover = rig_from_text(
        changed(two_coils_text, "{motion: displacement", f"{base}, base_from_flange0: {{rz_deg: 90}}")
    ).movers[0]
    assert mover.displacement_frame is DisplacementFrame.BASE
    assert mover.reference_rotation_rad == (0.0, 0.0, pytest.approx(math.pi / 2))


def test_a_positive_number_has_a_prior_without_negative_values(two_coils_text):
    rig = rig_from_text(
        changed(
            two_coils_text,
            "{value: 48, prior: {normal: {mean: 50, sd: 3, lower: 40}}}",
            "{prior: {normal: {mean: 50, sd: 90}}}",
        )
    )
    prior = rig.parameters["coil1.radius_m"].prior
    assert prior is not None
    assert prior.lower == 0.0
    offset = rig_from_text(two_coils_text).parameters["coil1.world_from_coil0.tilt_x_rad"].prior
    assert offset is not None
    assert offset.lower == -math.inf


def test_a_file_reads_like_its_text(two_coils_text, tmp_path):
    (tmp_path / "rig.yaml").write_text(two_coils_text, encoding="utf-8")
    assert load_rig(tmp_path / "rig.yaml") == rig_from_text(two_coils_text)
    with pytest.raises(InvalidInput, match=r"no\.yaml must be readable"):
        load_rig(tmp_path / "no.yaml")


NUMBERS = [
    ("name: two coils", "name: two coil"),
    ("x_mm: 415", "x_mm: 416"),
    ("value: 48", "value: 48.001"),
    ("mean: 50", "mean: 51"),
    ("sd: 3", "sd: 4"),
    ("lower: 40}}}\n    wire", "lower: 41}}}\n    wire"),
    ("wire_radius_mm: 0.49", "wire_radius_mm: 0.5"),
    ("upper: 50", "upper: 51"),
    ("z_cm: -4", "z_cm: -4.1"),
    ("factor: 1.5", "factor: 1.6"),
    ("median: 0.2", "median: 0.3"),
    ("relative_sd: 0.5", "relative_sd: 0.6"),
    ("tied_to: coil1.axial_loops", "tied_to: coil1.radial_loops"),
    ("motion: UR3e", "motion: UR3"),
    ("    carried_by: arm1", "    carried_by: arm1\n    field_sum: spherical_components"),
    ("    carried_by: arm1", "    carried_by: arm1\n    current_gain: 1.01"),
]


@pytest.mark.parametrize(("old", "new"), NUMBERS)
def test_any_other_number_gives_another_hash(two_coils_text, old, new):
    assert rig_from_text(changed(two_coils_text, old, new)).hash != rig_from_text(two_coils_text).hash


def test_comments_do_not_change_the_hash(two_coils_text):
    assert rig_from_text(two_coils_text + "# note\n").hash == rig_from_text(two_coils_text).hash
