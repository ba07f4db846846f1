"""Rig files and plans that no laboratory writes: refused in one sentence, at once, whatever they would unfold to."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.cli.grid import _axis
from estimator.errors import InvalidInput
from estimator.readings.plan import load_plan
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.yaml_section import Section

LONGEST_S = 60.0  # on a busy computer; the longest takes ten seconds alone
BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 10)
)
WIRE, LOOPS, COUNT = "wire_radius_mm: 0.98", "{prior: {normal: {mean: 12, sd: 1, lower: 1}}}", "count: 3}"
Z, CURRENT = "z_mm: 5", "coil1: 3"
COIL = "{radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}"
MANY = "wire_radius_mm: 0.1\n    axial_loops: 4000\n    radial_loops: 51"
NINES = "9" * 5000

RIGS = {
    "aliases that unfold to 10^10 values": ("name: small", f"{BOMB}name: *a9", "at most 100000 keys and values"),
    "an alias inside its own list": ("name: small", "name: &a [*a]", "must not hold itself; *a does (line 2)"),
    "an alias inside its own section": ("sensors:", "sensors: &a\n  x: *a", "must not hold itself; *a does"),
    "nested lists": ("name: small", "name: " + "[" * 100_000, "at most 20 levels; there are more (line 2)"),
    "closed nested lists": ("name: small", f"name: {'[' * 300}{']' * 300}", "at most 20 levels"),
    "nested sections": ("name: small", "name:\n" + "".join(f"{' ' * i}a:\n" for i in range(1, 1000)), "at most 20 levels"),
    "a long text": ("name: small", f"name: {'x' * 4_000_001}", "rig.yaml must hold at most 4000000 bytes"),
    "thousands of digits": (WIRE, f"wire_radius_mm: {NINES}", "wire_radius_mm must be a finite number; received inf"),
    "hundreds of digits": (WIRE, f"wire_radius_mm: {NINES[:400]}", "must be a finite number; received inf"),
    "a version of many digits": ("version: 1", f"version: {NINES}", "schema_version must be 1; received inf"),
    "a large length": (WIRE, "wire_radius_mm: 1e308", "must lie between -1e+12 and 1e+12; received 1e+308"),
    "a large prior": ("sd: 3", "sd: 1e200", "must lie between -1e+12 and 1e+12; received 1e+200"),
    "a long refused word": (WIRE, f"wire_radius_mm: {'x' * 9000}", "received 'xxx"),
    "half a character": ("name: small", 'name: "\\ud800"', "must hold whole characters; there is half a one (line 2)"),
    "tag of a whole number": (WIRE, "wire_radius_mm: !!int foo", "must be plain text, a number or a list"),
    "tag of no date": (WIRE, "wire_radius_mm: !!timestamp '2020-99-99'", "must be plain text, a number or a list"),
    "tag on a list": (WIRE, "wire_radius_mm: !!int [1]", "must be plain text, a number or a list"),
    "tag of Python": (WIRE, "wire_radius_mm: !!python/object:os.system x", "must be plain text, a number or a list"),
    "1e5 loops": (LOOPS, "1e5", "axial_loops must be at most 5000; received 100000"),
    "1e308 loops": (LOOPS, "1e308", "axial_loops must lie between"),
    "loops of a wide prior": (LOOPS, LOOPS.replace("sd: 1,", "sd: 1e6,"), "must have a prior no wider than 5000"),
    "loops of a far prior": (LOOPS, LOOPS.replace("12", "1e9"), "axial_loops must be at most 5000; received 1e+09"),
    "many turns": (f"{WIRE}\n    axial_loops: {LOOPS}\n    radial_loops: 3", MANY, "at most 200000; received 204000"),
    "201 coils": ("  coil1:", "".join(f"  c{i}: {COIL}\n" for i in range(200)) + "  coil1:", "coils must name at most 200"),
}  # fmt: skip

PLANS = {
    "a count of 1e9": (Z, "z_mm: {from: 0, to: 1, count: 1000000000}", "z_mm.count must be at most 200000; received 1e+09"),
    "a count of 1e308": (Z, "z_mm: {from: 0, to: 1, count: 1e308}", "z_mm.count must lie between"),
    "a grid of 1e9 stops": (COUNT, "count: 1000}", "poses.calibration must have at most 200000 stops; received 1000000000"),
    "1e9 repeats": ("name:", "repeats: 1000000000\nname:", "repeats must be at most 200000; received 1e+09"),
    "2e5 repeats": ("name:", "repeats: 200000\nname:", "the plan must have at most 200000 stops; received 7200000"),
    "1e9 revisited": ("name:", "revisited: 1000000000\nname:", "revisited must be at most 200000"),
    "1e9 scattered": ("calibration:", "calibration:\n    scattered: 1000000000", "scattered must be at most 200000"),
    "many currents": (f"[{{{CURRENT}}}]", f"[{', '.join(['{coil1: 1}'] * 40_000)}]", "at most 100000 keys and values"),
    "a current of many digits": (CURRENT, f"coil1: {NINES}", "currents_A must hold finite numbers"),
    "a large current": (CURRENT, "coil1: 1e308", "currents_A must hold numbers between -1e+12 and 1e+12"),
    "a large position": ("from: -40", "from: -1e308", "must lie between -1e+12 and 1e+12"),
    "a large pause": ("name:", "settle_s: 1e308\nname:", "settle_s must lie between"),
}  # fmt: skip


def refusal(read, *arguments: object) -> str:
    begin_s = time.monotonic()
    with pytest.raises(InvalidInput) as caught:
        read(*arguments)
    assert time.monotonic() - begin_s < LONGEST_S
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 500
    return message


@pytest.mark.parametrize(("old", "new", "message"), RIGS.values(), ids=RIGS)
def test_a_rig_file_is_refused(rig_text, old, new, message):
    assert old in rig_text
    assert message in refusal(rig_from_text, rig_text.replace(old, new, 1), "rig.yaml")


@pytest.mark.parametrize(("old", "new", "message"), PLANS.values(), ids=PLANS)
def test_a_plan_is_refused(plan_text, small_rig, tmp_path, old, new, message):
    assert old in plan_text
    (tmp_path / "plan.yaml").write_text(plan_text.replace(old, new), encoding="utf-8")
    assert message in refusal(load_plan, tmp_path / "plan.yaml", small_rig)


def test_a_file_without_end_is_refused():
    assert (
        refusal(load_rig, Path("/dev/zero"))
        == "/dev/zero must be readable as text, as a regular file; it is a device"
    )


@pytest.mark.parametrize("span", ["-50:50:1000000000", "0:1:1" + "0" * 30, "-1e308:1e308:3", "1e13"])
def test_a_grid_of_the_command_line_is_refused(span):
    assert refusal(_axis, f"x_mm={span}").startswith(
        "--grid must have at most 1000000 points within 1e+12 of 0"
    )


def test_what_an_alias_stands_for_counts_as_often_as_it_is_used():
    text = "noise: &noise {sd: 1}\n" + "".join(f"k{i}: *noise\n" for i in range(1000))
    assert Section.from_text(text, "rig.yaml").section("k999").number("sd") == 1.0


TEXTS = st.text("[]{}:,&*!|>-?#'\"%@ \n\tab19.e+\0é", max_size=60)


def complaint(read, *arguments: object) -> str:
    try:
        read(*arguments)
    except InvalidInput as error:
        return str(error)
    return ""


def read_all(text: str, file: str) -> None:
    section = Section.from_text(text, file)
    for key in section:
        section.value(key)


@given(TEXTS)
def test_any_text_is_a_section_or_refused_in_a_sentence(text: str) -> None:
    assert "\n" not in complaint(read_all, text, "rig.yaml")


@given(st.integers(0, 8), TEXTS)
def test_any_text_in_a_rig_file_is_read_or_refused(rig_text: str, line: int, text: str) -> None:
    lines = rig_text.splitlines()
    lines[2 * line] += text
    assert "\n" not in complaint(rig_from_text, "\n".join(lines), "rig.yaml")
