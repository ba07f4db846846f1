"""Coils without a winding in rig files: what they hold, what is refused, and that they come back to the last digit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from estimator.rig.arms import ARMS
from estimator.rig.bodies import HarmonicCoil, Region
from estimator.rig.parameters import Normal
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.write import rig_text
from tests.estimator.rig_files.test_write import check_same

CONFIGS = Path(__file__).parents[3] / "configs"
AMPLITUDES = "{sd_T_per_A: 8e-3, falloff: 0.5}"
TEXT = f"""schema_version: 1
name: box
movers: {{stage: {{motion: pose}}}}
coils:
  c1:
    model: harmonic
    region: exterior
    degree: 3
    reference_radius_mm: 50
    amplitudes: {AMPLITUDES}
    carried_by: stage
sensors: {{hall: {{noise_uT: 1}}}}
"""


def test_a_coil_has_a_region_a_degree_and_priors_that_fall_off():
    rig = rig_from_text(TEXT)
    assert rig.coils == (HarmonicCoil("c1", "stage", Region.EXTERIOR, 3),)
    assert (rig.wound, rig.unwound) == ((), rig.coils)
    assert len([p for p in rig.free if p.unit == "T/A"]) == 15
    assert rig.parameters["c1.degree1_sin1_T_per_A"].prior == Normal(0.0, 8e-3)
    assert rig.parameters["c1.degree3_cos2_T_per_A"].prior == Normal(0.0, 2e-3)
    assert rig.parameters["c1.reference_radius_m"].value == 0.05


@pytest.mark.parametrize(
    ("amplitudes", "written"),
    [
        (AMPLITUDES, "{sd_T_per_A: 0.008, falloff: 0.5}"),
        ("{sd_T_per_A: 7.3e-4, falloff: 0.37}", "{sd_T_per_A: 0.00073, falloff: 0.37}"),
        ("{sd_T_per_A: 1}", "{sd_T_per_A: 1.0}"),
        ("{sd_T_per_A: 0.01, degree1_cos0_T_per_A: 0.5}", "degree1_cos0_T_per_A: 0.5"),
        (
            "{sd_T_per_A: 0.01, degree2_cos0_T_per_A: {value: 1, prior: {normal: {mean: 0, sd: 2}}}}",
            "value: 1",
        ),
        (
            "{sd_T_per_A: 0.01, degree2_cos1_T_per_A: {tied_to: c1.degree2_cos0_T_per_A, factor: -1}}",
            "tied_to",
        ),
    ],
)
def test_it_comes_back_to_the_last_digit(amplitudes, written):
    rig = rig_from_text(TEXT.replace(AMPLITUDES, amplitudes))
    assert written in rig_text(rig)
    check_same(rig)


def test_without_a_common_width_every_amplitude_is_written():
    rig = rig_from_text(TEXT)
    fixed = rig.with_fixed(p.name for p in rig.free).with_values({"c1.degree2_sin1_T_per_A": 1.5e-3})
    assert "sd_T_per_A" not in rig_text(fixed)
    check_same(fixed)


REFUSALS = {
    "no width": (AMPLITUDES, "{falloff: 0.5}", 10,
        "coils.c1.amplitudes must state the width of its priors, sd_T_per_A"),
    "no amplitudes": (f"    amplitudes: {AMPLITUDES}\n", "", 6, "coils.c1.amplitudes is missing"),
    "width of zero": (AMPLITUDES, "{sd_T_per_A: 0}", 10,
        "coils.c1.amplitudes.sd_T_per_A must be > 0; received 0"),
    "width in another unit": (AMPLITUDES, "{sd_mT_per_A: 8}", 10,
        "sd_mT_per_A must be written as sd_T_per_A, in SI"),
    "growing": (AMPLITUDES, "{sd_T_per_A: 1, falloff: 1.5}", 10,
        "falloff must be above 0 and at most 1; received 1.5"),
    "degree of zero": ("degree: 3", "degree: 0", 8,
        "coils.c1.degree must be a whole number from 1 to 20; received 0"),
    "half a degree": ("degree: 3", "degree: 2.5", 8, "must be a whole number from 1 to 20; received 2.5"),
    "far too many": ("degree: 3", "degree: 21", 8, "must be a whole number from 1 to 20; received 21"),
    "another region": ("exterior", "outside", 7,
        "coils.c1.region must be one of interior, exterior; received 'outside'"),
    "another model": ("model: harmonic", "model: dipole", 6,
        "coils.c1.model must be one of winding, rectangular, racetrack, harmonic, equivalent_sources"),
    "no size": ("reference_radius_mm: 50", "reference_radius_mm: 0", 9,
        "reference_radius_mm must be > 0; received 0"),
    "a prior of the sphere": ("reference_radius_mm: 50",
        "reference_radius_mm: {prior: {normal: {mean: 50, sd: 1}}}", 9,
        "reference_radius_mm must be a plain number"),
    "a number of windings": ("degree: 3", "degree: 3\n    axial_loops: 12", 9,
        "coils.c1.axial_loops must not be given for a coil of model harmonic, which has no winding"),
    "an amplitude beyond the degree": (AMPLITUDES, "{sd_T_per_A: 1, degree4_cos0_T_per_A: 1}", 10,
        "coils.c1.amplitudes.degree4_cos0_T_per_A is not a known key"),
    "a bounded amplitude": (AMPLITUDES,
        "{sd_T_per_A: 1, degree1_cos0_T_per_A: {prior: {uniform: {lower: 0, upper: 1}}}}", 10,
        "degree1_cos0_T_per_A must have a normal prior without bounds, or none"),
}  # fmt: skip


def test_rigs_of_today_keep_their_hash():
    """A coil with a winding is described as before, so that sessions, chains and registries still know it."""
    assert load_rig(CONFIGS / "paper_simulation.yaml").hash.startswith(HASH)


def test_kinematics_of_one_arm_are_part_of_the_hash():
    rig = load_rig(CONFIGS / "paper_simulation.yaml")
    arm = replace(rig.movers[0], own_table=ARMS["UR5e"])
    assert replace(rig, movers=(arm,)).hash != rig.hash


HASH = "1dfec84bdd30f8ed"
