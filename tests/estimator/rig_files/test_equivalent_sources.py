"""Coils as charges on a box in rig files: what they hold, what is refused, and that they come back to the last digit."""

from __future__ import annotations

import numpy as np
import pytest

from estimator.cli.understood import _coil_words
from estimator.rig.bodies import EquivalentSourceCoil
from estimator.rig.parameters import Normal
from estimator.rig_files.read import rig_from_text
from estimator.rig_files.write import rig_text
from tests.estimator.rig_files.test_write import check_same

TEXT = """schema_version: 1
name: box
movers: {stage: {motion: pose}}
coils:
  c1:
    model: equivalent_sources
    half_x_mm: 5
    half_y_mm: 5
    half_z_cm: 1
    margin_mm: 4
    spacing_mm: 6
    amplitudes: {sd_T_per_A: 8e-3}
    carried_by: stage
sensors: {hall: {noise_uT: 1}}
"""


def test_a_coil_has_a_box_and_charges_with_one_prior():
    rig = rig_from_text(TEXT)
    (coil,) = rig.coils
    assert coil == EquivalentSourceCoil("c1", "stage", (0.005, 0.005, 0.01), 0.004, 0.006)
    assert (rig.wound, rig.unwound) == ((), rig.coils)
    assert coil.intervals == (3, 3, 5)
    free = [p for p in rig.free if p.unit == "T/A"]
    assert len(free) == 4 * 4 * 6 - 2 * 2 * 4
    assert {p.prior for p in free} == {Normal(0.0, 8e-3)}
    assert _coil_words(coil, {}) == "no winding, 80 magnetic charges on a box"


@pytest.mark.parametrize(
    ("amplitudes", "written"),
    [
        ("{sd_T_per_A: 8e-3}", "{sd_T_per_A: 0.008}"),
        ("{sd_T_per_A: 0.01, charge3_T_per_A: 0.5}", "charge3_T_per_A: 0.5"),
        ("{sd_T_per_A: 0.01, charge80_T_per_A: {tied_to: c1.charge1_T_per_A, factor: -1}}", "tied_to"),
    ],
)
def test_it_comes_back_to_the_last_digit(amplitudes, written):
    rig = rig_from_text(
        TEXT.replace("{sd_T_per_A: 8e-3}", amplitudes).replace("spacing_mm: 6", "spacing_mm: 6.1")
    )
    assert written in rig_text(rig)
    check_same(rig)
    other = rig_from_text(TEXT.replace("{sd_T_per_A: 8e-3}", amplitudes))
    assert other.hash != rig.hash


WITH_MULTIPOLES = TEXT.replace(
    "spacing_mm: 6", "spacing_mm: 6\n    multipoles_mm: [[0, 0, 12], [-6, 5.5, -3]]"
)
# The hash of TEXT before there were multipoles
HASH = "fb4df752b6bff2b7fe7694d12e7dd1c630715e6f06f360a8c749fc119b9f9bb7"


def test_multipoles_have_eight_amplitudes_each_and_come_back():
    rig = rig_from_text(WITH_MULTIPOLES)
    (coil,) = rig.coils
    assert isinstance(coil, EquivalentSourceCoil)
    np.testing.assert_allclose(coil.multipoles_m, [[0.0, 0.0, 0.012], [-0.006, 0.0055, -0.003]])
    np.testing.assert_allclose(coil.multipole_gaps_m, [2e-3, 1.118e-3], rtol=1e-3)
    own = [p for p in rig.free if ".multipole" in p.name]
    assert [p.name for p in own[:9:4]] == [
        "c1.multipole1_degree1_cos0_T_per_A",
        "c1.multipole1_degree2_cos1_T_per_A",
        "c1.multipole2_degree1_cos0_T_per_A",
    ]
    assert (len(own), {p.prior for p in own}) == (16, {Normal(0.0, 8e-3)})
    assert _coil_words(coil, {}) == "no winding, 80 magnetic charges on a box and 2 multipoles beside it"
    check_same(rig)


def test_the_places_of_multipoles_are_part_of_what_identifies_a_rig_and_none_leave_it_as_it_was():
    assert rig_from_text(TEXT).hash == HASH
    assert rig_from_text(WITH_MULTIPOLES).hash != rig_from_text(WITH_MULTIPOLES.replace("12]", "13]")).hash
    none = rig_from_text(WITH_MULTIPOLES.replace("[[0, 0, 12], [-6, 5.5, -3]]", "[]"))
    assert (none, none.hash) == (rig_from_text(TEXT), HASH)


REFUSALS = {
    "a place of two numbers": ("spacing_mm: 6", "spacing_mm: 6\n    multipoles_mm: [[0, 12]]", 12,
        "coils.c1.multipoles_mm must be a list of places, each of three numbers; received [[0, 12]]"),
    "a multipole among the readings": ("spacing_mm: 6", "spacing_mm: 6\n    multipoles_mm: [[0, 0, 9]]", 12,
        "coils.c1.multipoles_mm must lie outside the box that holds the readings of c1; received [0, 0, "
        "9]"),
    "a multipole twice": ("spacing_mm: 6", "spacing_mm: 6\n    multipoles_mm: [[0, 0, 12], [0, 0, 12]]", 12,
        "coils.c1.multipoles_mm must be places that differ; received [0, 0, 12] twice"),
    "no box": ("    half_y_mm: 5\n", "", 6, "coils.c1.half_y_m is missing"),
    "no unit": ("margin_mm: 4", "margin: 4", 10, "coils.c1.margin must carry its unit"),
    "no margin": ("margin_mm: 4", "margin_mm: 0", 10, "coils.c1.margin_mm must be > 0; received 0"),
    "a prior of the box": ("margin_mm: 4", "margin_mm: {prior: {normal: {mean: 4, sd: 1}}}", 10,
        "coils.c1.margin_mm must be a finite number"),
    "far too many": ("spacing_mm: 6", "spacing_mm: 0.5", 11,
        "coils.c1.spacing_mm must leave at most 3000 charges on the box; received 10658 charges"),
    "no width": ("{sd_T_per_A: 8e-3}", "{}", 12, "coils.c1.amplitudes must state the width of its priors"),
    "degrees": ("{sd_T_per_A: 8e-3}", "{sd_T_per_A: 8e-3, falloff: 0.5}", 12,
        "coils.c1.amplitudes.falloff is not a known key"),
    "a number of windings": ("spacing_mm: 6", "spacing_mm: 6\n    axial_loops: 12", 12,
        "coils.c1.axial_loops must not be given for a coil of model equivalent_sources, which has no "
        "winding"),
}  # fmt: skip
