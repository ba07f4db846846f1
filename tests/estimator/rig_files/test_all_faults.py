"""All mistakes of a rig file at once: each as the reader refuses it alone, and none that only follows from another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from estimator.errors import InvalidInput, Place
from estimator.rig_files.read import load_rig, rig_and_faults
from tests.estimator.conftest import TWO_COILS
from tests.estimator.rig_files import test_effects_section as causes
from tests.estimator.rig_files import test_equivalent_sources as charges
from tests.estimator.rig_files import test_harmonic as harmonic
from tests.estimator.rig_files import test_refusals as bodies
from tests.estimator.rig_files import test_sided as sided


def changed(
    text: str, refusals: Mapping[str, tuple[str, str, int | None, str]]
) -> Iterator[tuple[str, str, int | None]]:
    """A file with one mistake each, what is said of it, and the line; None where the sentence says both lines."""
    for name, (old, new, line, message) in refusals.items():
        assert text.count(old) == 1, name
        yield text.replace(old, new), message, line


CASES = (
    *changed(TWO_COILS, bodies.REFUSALS),
    *changed(harmonic.TEXT, harmonic.REFUSALS),
    *changed(charges.TEXT, charges.REFUSALS),
    *changed(sided.TEXT, sided.REFUSALS),
    *((causes.RIG + effects, message, line) for effects, line, message in causes.REFUSALS.values()),
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "rig.yaml"


@pytest.mark.parametrize(("text", "message", "line"), CASES, ids=[message for _, message, _ in CASES])
def test_a_mistake_is_named_by_key_rule_value_and_line_and_has_no_followers(text, message, line, path):
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidInput) as raised:
        load_rig(path)
    said, place = str(raised.value), raised.value.place
    assert place is not None
    assert place.column is not None
    assert message in said
    assert said.endswith(f"{path}, line {line})" if line else f"({path})")
    if "axis_gain[probe].x must be given once" not in message:  # the others that it left out are mistakes too
        assert [(str(fault), fault.place) for fault in rig_and_faults(path)[1]] == [(said, place)]


def test_mistakes_of_all_kinds_are_told_at_once_in_the_order_of_their_lines(path):
    text = TWO_COILS
    for old, new in (
        ("schema_version: 1", "schema_version: 3"),
        ("arm1: {motion: displacement}", "arm1: {motion: displacment}"),
        ("    radial_loops: 22\n", "    radial_lops: 22\n    radial_loop: 3\n"),
        ("z_cm: -4", "z_kg: -4"),
        ("    carried_by: arm2", "    carried_by: arm3"),
        ("axial_pitch_mm: 1.7", "axial_pitch: 1.7\n    field_sum: sum"),
        ("  hall:", "  hall:\n    gian: 1"),
        ("relative_sd: 0.5", "relative_sd: -1"),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    path.write_text(text + "effects:\n  axis_gian[hall]: {}\nrobots: {}\n", encoding="utf-8")
    rig, faults = rig_and_faults(path)
    assert rig is None  # nobody can say which columns arm1 has
    told = [(fault.place.line, fault.place.column, str(fault)) for fault in faults if fault.place]
    assert [(line, column, words.partition(";")[0].partition(" (")[0]) for line, column, words in told] == [
        (1, 1, "schema_version must be 1"),
        (
            4,
            10,
            "movers.arm1.motion must be one of pose, displacement, joints, UR3, UR5, UR10, UR3e, UR5e, UR10e, UR16e, UR20",
        ),
        (8, 5, "coils.coil1.radial_loops is missing"),
        (13, 5, "coils.coil1.radial_loop is not a known key"),
        (14, 24, "coils.coil1.world_from_coil0.z_kg must carry its unit: write z_m or z_cm or z_mm or z_um"),
        (16, 5, "coils.coil2.carried_by must name a mover"),
        (
            18,
            5,
            "coils.coil2.axial_pitch must carry its unit: write axial_pitch_m or axial_pitch_cm or axial_pitch_mm or axial_pitch_um",
        ),
        (19, 5, "coils.coil2.field_sum must be one of vectors, spherical_components"),
        (25, 5, "sensors.hall.gian is not a known key"),
        (26, 15, "sensors.hall.noise_G.prior.log_normal.relative_sd must be > 0"),
        (28, 3, "effects.axis_gian[hall] must be a cause that coilcal knows"),
        (29, 1, "robots is not a known key"),
    ]
    assert "the closest is radial_lops" in told[2][2]


def test_numbers_that_cannot_be_read_leave_the_names_of_a_rig(path):
    path.write_text(TWO_COILS.replace("wire_radius_mm: 0.49", "wire_radius_mm: 0,49"), encoding="utf-8")
    rig, faults = rig_and_faults(path)
    assert rig is not None
    assert ([coil.name for coil in rig.coils], len(faults)) == (["coil1", "coil2"], 1)
    assert str(rig.nominal_values()["coil1.axial_pitch_m"]) == "nan"


@pytest.mark.parametrize(
    ("text", "line", "column"),
    [("name: [1, 2\nsensors: 3\n", 2, 8), ("name: small\n  coils: 3\n", 2, 8), ("a: &a [*a]\n", 1, 11)],
)
def test_what_is_not_yaml_is_one_fault_with_line_and_column(path, text, line, column):
    path.write_text(text, encoding="utf-8")
    rig, faults = rig_and_faults(path)
    assert rig is None
    assert [fault.place for fault in faults] == [Place(str(path), line, column)]


def test_a_file_that_is_not_there_is_one_fault_without_a_place(path):
    rig, (fault,) = rig_and_faults(path)
    assert (rig, fault.place) == (None, None)
    assert "must be readable as text" in str(fault)


def test_a_rig_without_faults_is_the_one_that_is_loaded(path):
    path.write_text(TWO_COILS, encoding="utf-8")
    assert rig_and_faults(path) == (load_rig(path), [])
