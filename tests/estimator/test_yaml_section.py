"""Sections of a YAML file: numbers are read as a laboratory writes them, and every fault names file, line and key."""

from __future__ import annotations

import math

import pytest

from estimator.errors import InvalidInput
from estimator.yaml_section import Section


def section(text: str) -> Section:
    return Section.from_text(text, "rig.yaml")


def refusal(text: str, read) -> str:
    with pytest.raises(InvalidInput) as caught:
        read(section(text))
    return str(caught.value)


@pytest.mark.parametrize(
    ("written", "number"),
    [
        ("2e-5", 2e-5),
        ("2E5", 2e5),
        ("-.5", -0.5),
        ("+3.", 3.0),
        ("010", 10.0),  # ten, not the eight of YAML 1.1
        ("51", 51.0),
    ],
)
def test_a_number_is_read_as_it_is_meant(written, number):
    assert section(f"a: {written}").number("a") == number


@pytest.mark.parametrize(
    "written",
    [".nan", ".inf", "-.inf", "1:30", "-50:50:11", "1_000", "0x10", "0,98", "51 mm", "yes", "", "two", "[1]"],
)
def test_what_is_no_finite_number_is_refused(written):
    message = refusal(f"\na: {written}", lambda s: s.number("a"))
    assert message.startswith("a must be a finite number; received ")
    assert message.endswith("(rig.yaml, line 2)")


def test_a_date_and_a_version_stay_text():
    s = section("day: 2025-13-45\nversion: 1.2.3")
    assert (s.value("day"), s.value("version")) == ("2025-13-45", "1.2.3")


@pytest.mark.parametrize(
    ("key", "si"), [("radius_m", 0.25), ("radius_cm", 0.0025), ("radius_mm", 0.00025), ("radius_um", 2.5e-7)]
)
def test_a_length_is_converted_to_metres(key, si):
    name, value = section(f"{key}: 0.25").quantity("radius", "length")
    assert name == "radius_m"
    assert value == pytest.approx(si, rel=1e-15)


@pytest.mark.parametrize(
    ("key", "dimension", "si"),
    [
        ("a_deg", "angle", math.radians(3)),
        ("a_mrad", "angle", 3e-3),
        ("a_mA", "current", 3e-3),
        ("a_uT", "field", 3e-6),
        ("a_mT", "field", 3e-3),
        ("a_G", "field", 3e-4),
    ],
)
def test_other_units_are_converted(key, dimension, si):
    assert section(f"{key}: 3").quantity("a", dimension)[1] == pytest.approx(si, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "radius: 3",
            "radius must carry its unit: write radius_m or radius_cm or radius_mm or radius_um; received 3 (rig.yaml, line 1)",
        ),
        (
            "radius_inch: 3",
            "radius_inch must carry its unit: write radius_m or radius_cm or radius_mm or radius_um; received 3 (rig.yaml, line 1)",
        ),
        (
            "radius_deg: 3",
            "radius_deg must be in a unit of length (m, cm, mm, um); received 3 in deg (rig.yaml, line 1)",
        ),
        (
            "radius_m: 3\nradius_mm: 3000",
            "radius_mm must be given in one unit; received radius_m and radius_mm (rig.yaml, line 2)",
        ),
    ],
)
def test_a_quantity_without_its_unit_is_refused(text: str, message: str) -> None:
    assert refusal(text, lambda s: s.quantity("radius", "length")) == message


def test_a_key_given_twice_is_refused_with_both_lines():
    message = refusal("a: 1\nb: 2\na: 3", lambda s: s)
    assert message == "a must be given once; received it in lines 1 and 3 (rig.yaml)"


def test_an_absent_section_is_empty_and_a_value_is_no_section():
    assert list(section("a: 1").section("b")) == []
    assert (
        refusal("a: 1", lambda s: s.section("a"))
        == "a must hold keys and values; received 1 (rig.yaml, line 1)"
    )


def test_a_choice_outside_its_list_is_refused():
    assert section("a: x").choice("a", ("x", "y")) == "x"
    assert section("b: 1").choice("a", ("x", "y"), "y") == "y"
    message = refusal("a: Y", lambda s: s.choice("a", ("x", "y")))
    assert message == "a must be one of x, y; received 'Y' (rig.yaml, line 1)"


@pytest.mark.parametrize("text", ["a: !foo 3", "a: {[1]: 2}"])
def test_exotic_yaml_is_refused_in_a_sentence(text):
    assert refusal(text, lambda s: s.value("a")) == (
        "a must be plain text, a number or a list (rig.yaml, line 1)"
    )


def test_a_key_that_is_a_list_is_refused():
    assert refusal("\n[1, 2]: 3", lambda s: s) == "the file must have words as keys (rig.yaml, line 2)"


@pytest.mark.parametrize("text", ["", "# nothing\n", "a,b\n1,2\n", "- 1\n- 2\n"])
def test_a_file_that_holds_no_keys_is_refused(text):
    assert refusal(text, lambda s: s).startswith("rig.yaml must hold keys and values; it holds ")


@pytest.mark.parametrize("text", ["a: [1", "a: 1\n\tb: 2", "a: 1\n b: 2", "a: 1\n---\na: 2", "a: \x01"])
def test_broken_yaml_is_refused_in_one_line(text):
    message = refusal(text, lambda s: s)
    assert message.startswith("rig.yaml must be YAML; ")
    assert "\n" not in message


def test_a_file_is_read_with_the_mark_and_line_ends_of_windows(tmp_path):
    path = tmp_path / "rig.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: b\r\na: 1\r\n")
    assert list(Section.from_file(path)) == ["name", "a"]


def test_an_unreadable_file_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match=r"no\.yaml must be readable as text: No such file"):
        Section.from_file(tmp_path / "no.yaml")
    with pytest.raises(InvalidInput, match="must be readable as text: Is a directory"):
        Section.from_file(tmp_path)
    (tmp_path / "latin.yaml").write_bytes(b"name: G\xf6ttingen")
    with pytest.raises(InvalidInput, match="must be readable as text: 'utf-8'"):
        Section.from_file(tmp_path / "latin.yaml")
