"""Every mistake in a rig file is named by key, rule, value, file and line."""

from __future__ import annotations

import pytest

from estimator.errors import InvalidInput
from estimator.rig_files.read import rig_from_text

UNITS_OF_LENGTH = "wire_radius_m or wire_radius_cm or wire_radius_mm or wire_radius_um"
WIRE = "wire_radius_mm: 0.49"
PRIOR = "normal: {mean: 50, sd: 3, lower: 40}"
REFUSALS = {
    "unknown key": (WIRE, f"{WIRE}\n    current_gian: 1", 11,
        "coils.coil1.current_gian is not a known key; the closest is current_gain"),
    "unknown key at the top": ("sensors:", "robots: {}\nsensors:", 21, "robots is not a known key"),
    "pose of a body that is carried": ("  hall:", "  hall:\n    carried_by: arm2\n    world_from_sensor: {}",
        24, "sensors.hall.world_from_sensor must be flange_from_sensor for a sensor that arm2 carries, for "
        "arm2 reports where its flange is; received world_from_sensor"),
    "pose of a body that a stage carries": ("    world_from_coil0:", "    world_from_coil:", 13,
        "coils.coil1.world_from_coil must be world_from_coil0 for a coil that arm1 carries, its pose "
        "where arm1 reports zero displacement; received world_from_coil"),
    "pose of a body that stands still": ("  hall:", "  hall:\n    world_from_sensor0: {}", 23,
        "sensors.hall.world_from_sensor0 must be world_from_sensor for a sensor that stands still; only "
        "one that is carried_by a mover has another pose; received world_from_sensor0"),
    "unknown sum": (WIRE, f"{WIRE}\n    field_sum: sum", 11,
        "coils.coil1.field_sum must be one of vectors, spherical_components; received 'sum'"),
    "no truth": (WIRE, f"{WIRE}\n    superconducting: 4.2", 11,
        "coils.coil1.superconducting must be true or false; received 4.2"),
    "missing key": ("    radial_loops: 22\n", "", 8, "coils.coil1.radial_loops is missing"),
    "another word": ("    radial_loops: 22", "    radial_turns: 22", 8,
        "coils.coil1.radial_loops is missing; the closest is radial_turns"),
    "missing wire": (f"    {WIRE}\n", "", 8, "coils.coil1.wire_radius_m is missing"),
    "missing version": ("schema_version: 1\n", "", 1, "schema_version is missing"),
    "other version": ("schema_version: 1", "schema_version: 2", 1, "schema_version must be 1; received 2"),
    "missing unit": (WIRE, "wire_radius: 0.49", 10,
        f"coils.coil1.wire_radius must carry its unit: write {UNITS_OF_LENGTH}; received 0.49"),
    "unknown unit": (WIRE, "wire_radius_inch: 0.49", 10,
        f"coils.coil1.wire_radius_inch must carry its unit: write {UNITS_OF_LENGTH}; received 0.49"),
    "wrong dimension": (WIRE, "wire_radius_deg: 0.49", 10,
        "coils.coil1.wire_radius_deg must be in a unit of length (m, cm, mm, um); received 0.49 in deg"),
    "same key twice": (WIRE, f"{WIRE}\n    {WIRE}", None,
        "coils.coil1.wire_radius_mm must be given once; received it in lines 10 and 11"),
    "same quantity in two units": (WIRE, f"{WIRE}\n    wire_radius_m: 0.1", 11,
        "coils.coil1.wire_radius_m must be given in one unit; received wire_radius_mm and wire_radius_m"),
    "no bore": ("radial_loops: 22", "radial_loops: 60", 9,
        "coils.coil1.radius_mm must exceed radial_pitch x radial_loops = 58.8 mm (no bore is left); "
        "received 48 mm"),
    "no bore through a tie": ("factor: 1.5", "factor: 0.5", 16,
        "coils.coil2.radius_mm must exceed radial_pitch x radial_loops = 33 mm (no bore is left); "
        "received 24 mm"),
    "zero": (WIRE, "wire_radius_mm: 0", 10, "coils.coil1.wire_radius_mm must be > 0; received 0"),
    "negative": (WIRE, "wire_radius_mm: -0.49", 10, "coils.coil1.wire_radius_mm must be > 0; received -0.49"),
    "negative through a tie": ("factor: 1.5", "factor: -1.5", 16,
        "coils.coil2.radius_mm must be > 0; received -0.072 m"),
    "less than one loop": ("radial_loops: 22", "radial_loops: 0.5", 12,
        "coils.coil1.radial_loops must be at least 1; received 0.5"),
    "less than one loop through a tie": ("{tied_to: coil1.axial_loops}",
        "{tied_to: coil1.axial_loops, factor: 0.01}", 19,
        "coils.coil2.axial_loops must be at least 1; received 0.45"),
    "value outside its prior": ("value: 48", "value: 39", 9,
        "coils.coil1.radius_mm must lie within its prior (40 to inf); received 39"),
    "unknown mover": ("    carried_by: arm1", "    carried_by: arm3", 8,
        "coils.coil1.carried_by must name a mover (arm1, arm2); received 'arm3'; the closest is arm2"),
    "base frame without its rotation": ("{motion: displacement",
        "{motion: displacement, displacement_frame: base", 4,
        "movers.arm1.displacement_frame base needs the rotation base_from_flange0 {rx, ry, rz}; received "
        "none"),
    "unknown motion": ("motion: UR3e", "motion: UR7", 5,
        "movers.arm2.motion must be one of pose, displacement, joints, UR3, UR5, UR10, UR3e, UR5e, UR10e, "
        "UR16e, UR20; received 'UR7'"),
    "joint angles without kinematics": ("motion: UR3e", "motion: joints", 5,
        "movers.arm2.motion joints needs the table denavit_hartenberg {theta, a, d, alpha}, or urdf "
        "{file, base, flange}; received none"),
    "five joints": ("motion: UR3e", "motion: UR3e, factory_corrections: {a_mm: [0, 1, 2, 3, 4]}", 5,
        "movers.arm2.factory_corrections.a_mm must be a list of 6 numbers within -1e+12 and 1e+12, one "
        "for each joint; received [0, 1, 2, 3, 4]"),
    "lengths in degrees": ("motion: UR3e", "motion: UR3e, factory_corrections: {d_deg: [0, 0, 0, 0, 0, 0]}",
        5, "movers.arm2.factory_corrections.d_deg must be in a unit of length (m, cm, mm, um); received [0, "
        "0, 0, 0, 0, 0] in deg"),
    "tie to nothing": ("tied_to: coil1.radius_m", "tied_to: coil1.radius_mm", 16,
        "coils.coil2.radius_mm must be tied to a parameter of the rig, by its name in SI; received "
        "'coil1.radius_mm'; the closest is coil1.radius_m"),
    "tie to itself": ("tied_to: coil1.radius_m", "tied_to: coil2.radius_m", 16,
        "coils.coil2.radius_mm must not be tied in a circle; received coil2.radius_m -> coil2.radius_m"),
    "tie in a circle": (WIRE, "wire_radius_mm: {tied_to: coil1.axial_pitch_m}", 10,
        "coils.coil1.wire_radius_mm must not be tied in a circle; received coil1.wire_radius_m -> "
        "coil1.axial_pitch_m -> coil1.wire_radius_m"),
    "tie to another dimension": ("tied_to: coil1.radius_m", "tied_to: coil1.radial_loops", 16,
        "coils.coil2.radius_mm must be tied to a parameter in m; received coil1.radial_loops in 1"),
    "unknown prior": (PRIOR, "gaussian: {mean: 50, sd: 3}", 9,
        "coils.coil1.radius_mm.prior must be one of normal, log_normal, uniform; received gaussian"),
    "two priors": (PRIOR, "normal: {mean: 50, sd: 3}, uniform: {lower: 1, upper: 2}", 9,
        "coils.coil1.radius_mm.prior must be one of normal, log_normal, uniform; received normal and "
        "uniform"),
    "empty prior": (f"{{{PRIOR}}}", "{}", 9,
        "coils.coil1.radius_mm.prior must be one of normal, log_normal, uniform; received nothing"),
    "prior in a word": (f"{{{PRIOR}}}", "normal", 9,
        "coils.coil1.radius_mm.prior must hold keys and values; received 'normal'"),
    "prior without width": (PRIOR, "normal: {mean: 50}", 9,
        "coils.coil1.radius_mm.prior.normal.sd is missing"),
    "prior of another kind's key": (PRIOR, "normal: {mean: 50, sd: 3, median: 1}", 9,
        "coils.coil1.radius_mm.prior.normal.median is not a known key"),
    "prior of negative width": (PRIOR, "normal: {mean: 50, sd: -3}", 9,
        "coils.coil1.radius_mm.prior.normal.sd must be > 0; received -3.0"),
    "prior of NaN": (PRIOR, "normal: {mean: .nan, sd: 3}", 9,
        "coils.coil1.radius_mm.prior.normal.mean must be a finite number; received nan"),
    "prior of crossed bounds": ("lower: 40, upper: 50", "lower: 50, upper: 40", 11,
        "coils.coil1.axial_loops.prior.uniform.lower must be below upper; received (50.0, 40.0)"),
    "log-normal of median 0": ("median: 0.2", "median: 0", 23,
        "sensors.hall.noise_G.prior.log_normal.median must be > 0; received 0.0"),
    "log-normal of no width": ("relative_sd: 0.5", "relative_sd: 0", 23,
        "sensors.hall.noise_G.prior.log_normal.relative_sd must be > 0; received 0.0"),
    "negative bound of a positive number": (PRIOR, "normal: {mean: 50, sd: 3, lower: -1}", 9,
        "coils.coil1.radius_mm.prior.normal.lower must be at least 0, as the quantity is positive; "
        "received -1"),
    "negative mean of a positive number": (PRIOR, "normal: {mean: -50, sd: 3}", 9,
        "coils.coil1.radius_mm.prior.normal.mean must be at least 0, as the quantity is positive; "
        "received -50"),
    "NaN": (WIRE, "wire_radius_mm: .nan", 10,
        "coils.coil1.wire_radius_mm must be a finite number; received nan"),
    "text": (WIRE, "wire_radius_mm: 0,49", 10,
        "coils.coil1.wire_radius_mm must be a finite number; received '0,49'"),
    "nothing": (WIRE, "wire_radius_mm:", 10,
        "coils.coil1.wire_radius_mm must be a finite number; received None"),
    "yes": ("radial_loops: 22", "radial_loops: yes", 12,
        "coils.coil1.radial_loops must be a finite number; received True"),
    "number instead of keys": ("{motion: displacement}", "3", 4,
        "movers.arm1 must hold keys and values; received 3"),
    "name with a slash": ("  hall:", "  hall/1:", 22,
        "sensors.hall/1 must be named by letters, digits, _ and - only; received 'hall/1'"),
    "name of two things": ("  hall:", "  coil1:", 22,
        "sensors.coil1 must have a name of its own; received 'coil1', which is taken"),
}  # fmt: skip


@pytest.mark.parametrize("kind", ["coils", "sensors"])
def test_a_rig_has_coils_and_sensors(kind):
    text = f"schema_version: 1\nname: nothing\n{kind}: {{}}\n"
    other_kind = (
        "sensors: {hall: {noise_uT: 5}}"
        if kind == "coils"
        else ("coils: {coil1: {radius_mm: 9, wire_radius_mm: 1, axial_loops: 1, radial_loops: 1}}")
    )
    with pytest.raises(InvalidInput) as caught:
        rig_from_text(text + other_kind, "rig.yaml")
    assert str(caught.value) == f"{kind} must name at least one; received none (rig.yaml, line 3)"


def test_a_carrier_is_refused_where_the_rig_has_no_movers():
    text = "schema_version: 1\nname: a\ncoils: {c: {carried_by: arm, radius_mm: 9, wire_radius_mm: 1, axial_loops: 1, radial_loops: 1}}"
    with pytest.raises(InvalidInput, match=r"must name a mover \(the rig has none\); received 'arm'"):
        rig_from_text(text)
