"""A rig that is written and read again is the same rig, to the last bit of every number."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from estimator.effects import EFFECTS
from estimator.effects.circumstances import Extent
from estimator.errors import InvalidInput
from estimator.rig.arms import ARMS, DenavitHartenberg
from estimator.rig.bodies import POSE_QUANTITIES, Coil, DisplacementFrame, FieldSum, MotionKind, Mover, Sensor
from estimator.rig.parameters import LogNormal, Normal, Parameter, Prior, Tie, Uniform
from estimator.rig.rig import Cause, Rig
from estimator.rig_files.numbers import SI_SYMBOL
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.write import rig_text

CONFIGS = sorted((Path(__file__).resolve().parents[3] / "configs").glob("*.yaml"))
NAMES = st.from_regex(r"[A-Za-z0-9_-]{1,8}", fullmatch=True) | st.sampled_from(
    ["null", "on", "1e5", "007", "1_0"]
)
SETTINGS = st.recursive(
    st.text(max_size=8) | st.booleans() | st.integers() | st.none() | st.floats(allow_nan=False),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(min_size=1, max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)


def decimal(low: float, high: float) -> st.SearchStrategy[float]:
    """Any float of a range, and those that people write."""
    return st.floats(low, high) | st.floats(low, high).map(lambda x: min(max(round(x, 4), low), high))


def signed(scale: float) -> st.SearchStrategy[float]:
    return decimal(-scale, scale) | st.sampled_from([0.0, -0.0])


@st.composite
def priors(draw: st.DrawFn, typical: float, is_positive: bool) -> Prior:
    """With no bound, one, or both, that leave something between them."""
    kind = draw(
        st.sampled_from(["normal", "log_normal", "uniform"] if is_positive else ["normal", "uniform"])
    )
    scale = abs(typical) or 1e-3
    lower = draw(decimal(0.1, 0.5) if is_positive else decimal(-3.0, -1.0)) * scale
    upper = draw(decimal(1.5, 5.0)) * scale
    assume(lower < upper)
    if kind == "uniform":
        return Uniform(lower, upper)
    ends = {"lower": lower} if draw(st.booleans()) else {"lower": 0.0} if is_positive else {}
    ends |= {"upper": upper} if draw(st.booleans()) else {}
    width = draw(decimal(1e-3, 1.0))
    assume(width * scale > 0.0)  # which the smallest numbers lose
    if kind == "log_normal":
        return LogNormal(typical, width, **ends)
    return Normal(typical, width * scale, **ends)


@st.composite
def number(
    draw: st.DrawFn,
    name: str,
    unit: str,
    value: float,
    others: dict[str, Parameter],
    is_positive: bool = False,
    is_count: bool = False,
) -> Parameter:
    """A parameter that is fixed, free, or tied to one that is there already."""
    same = [n for n, p in others.items() if p.unit == unit and p.is_count == is_count]
    kinds = ["fixed", "free", "value", *(["tied"] if same and not is_count else [])]
    kind = draw(st.sampled_from(kinds))
    if kind == "tied":
        tie = Tie(draw(st.sampled_from(same)), draw(decimal(0.5, 2.0) | st.just(1.0)))
        return Parameter(name, unit, 0.0, None, tie, is_positive, is_count)
    prior = None if kind == "fixed" else draw(priors(value, is_positive))
    if prior is not None and (kind == "free" or not prior.lower <= value <= prior.upper):
        value = prior.centre
    assume(not is_count or value >= 1.0)
    return Parameter(name, unit, value, prior, None, is_positive, is_count)


@st.composite
def rigs(draw: st.DrawFn) -> Rig:
    names = draw(st.lists(NAMES, min_size=8, max_size=8, unique=True))
    numbers: dict[str, Parameter] = {}

    def add(name: str, unit: str, value: float, is_positive: bool = False, is_count: bool = False) -> None:
        numbers[name] = draw(number(name, unit, value, numbers, is_positive, is_count))

    def pose(prefix: str) -> None:
        for quantity, dimension in POSE_QUANTITIES:
            unit = SI_SYMBOL[dimension]
            name = f"{prefix}.{quantity}_{unit}"
            if draw(st.booleans()):
                numbers[name] = Parameter(name, unit, 0.0)
            else:
                add(name, unit, draw(signed(2.0)))

    column = st.tuples(*[signed(3.0)] * 6)
    tables = st.builds(DenavitHartenberg, column, column, column, column)
    movers = []
    for name in names[: draw(st.integers(0, 2))]:
        motion = draw(st.sampled_from(MotionKind))
        is_in_base = motion is MotionKind.DISPLACEMENT and draw(st.booleans())
        rotation = draw(st.tuples(*[signed(3.0)] * 3)) if is_in_base else (0.0, 0.0, 0.0)
        frame = DisplacementFrame.BASE if is_in_base else DisplacementFrame.END_EFFECTOR
        own_table = draw(tables) if motion is MotionKind.JOINTS else None
        if str(motion) in ARMS and draw(st.booleans()):
            own_table = draw(tables)
        movers.append(Mover(name, motion, frame, rotation, own_table))
        if motion is not MotionKind.DISPLACEMENT:
            pose(f"{name}.world_from_base")

    def body_pose(name: str, kind: str) -> str | None:
        mover = draw(st.sampled_from([None, *movers]))
        if mover is None:
            pose(f"{name}.world_from_{kind}")
            return None
        if mover.motion is MotionKind.DISPLACEMENT:
            pose(f"{name}.world_from_{kind}0")
        pose(f"{name}.flange_from_{kind}")
        return mover.name

    def gain(name: str) -> None:
        if draw(st.booleans()):
            numbers[name] = Parameter(name, "1", 1.0)
        else:
            add(name, "1", draw(decimal(0.5, 2.0)))

    coils = []
    for name in names[2 : 3 + draw(st.integers(0, 1))]:
        add(f"{name}.radius_m", "m", draw(decimal(0.05, 3.0)), is_positive=True)
        follows = [draw(st.booleans()) for _ in range(2)]
        if any(follows) or draw(st.booleans()):
            add(f"{name}.wire_radius_m", "m", draw(decimal(1e-4, 1e-3)), is_positive=True)
        for pitch, is_tied in zip(("axial_pitch_m", "radial_pitch_m"), follows, strict=True):
            if is_tied:
                tie = Tie(f"{name}.wire_radius_m", 2.0)
                numbers[f"{name}.{pitch}"] = Parameter(f"{name}.{pitch}", "m", 0.0, None, tie, True)
            else:
                add(f"{name}.{pitch}", "m", draw(decimal(1e-4, 1e-3)), is_positive=True)
        for count in ("axial_loops", "radial_loops"):
            add(f"{name}.{count}", "1", draw(decimal(1.0, 20.0)), is_positive=True, is_count=True)
        gain(f"{name}.current_gain")
        carried_by = body_pose(name, "coil")
        coils.append(Coil(name, carried_by, draw(st.sampled_from(FieldSum)), draw(st.booleans())))
    sensors = []
    for name in names[4 : 5 + draw(st.integers(0, 1))]:
        add(f"{name}.noise_T", "T", draw(decimal(1e-9, 1e-3)), is_positive=True)
        gain(f"{name}.gain")
        sensors.append(Sensor(name, body_pose(name, "sensor")))
    title = draw(NAMES | st.just("12:30") | st.text(max_size=20).filter(str.isprintable))
    rig = Rig(title, tuple(coils), tuple(sensors), tuple(movers), numbers)
    for name in draw(st.lists(st.sampled_from(sorted(EFFECTS)), max_size=3, unique=True)):
        places = EFFECTS[name].places(rig)
        if places:
            rig = draw(with_cause(rig, Cause(name, draw(st.sampled_from(places)))))
    assume(rig.broken_rule() is None)
    devices = (
        {}
        if draw(st.booleans())
        else {sensors[0].name: {"sensor": "x", **draw(st.dictionaries(st.just("more"), SETTINGS))}}
    )
    return replace(rig, devices=devices)


@st.composite
def with_cause(draw: st.DrawFn, rig: Rig, cause: Cause) -> Rig:
    """An effect with its numbers: fixed, or free with the prior that it comes with."""
    parameters = []
    for quantity in EFFECTS[cause.name].quantities(Extent()):
        prior = quantity.prior if draw(st.booleans()) else None
        value = quantity.prior.centre
        if draw(st.booleans()):
            low, high = (max(quantity.prior.lower, -1.0), min(quantity.prior.upper, 1.0))
            assume(low < high)
            value = draw(st.floats(low, high, exclude_min=quantity.is_positive))
        name = f"{cause.label}.{quantity.key}"
        parameters.append(Parameter(name, quantity.unit, value, prior, is_positive=quantity.is_positive))
    values = {p.name.rpartition(".")[2]: p.value for p in parameters}
    assume(EFFECTS[cause.name].broken_rule(values) is None)
    add = rig.with_correction if EFFECTS[cause.name].is_correction else rig.with_cause
    return add(cause, parameters)


def check_same(rig: Rig) -> None:
    text = rig_text(rig)
    again = rig_from_text(text)
    assert again == rig
    assert again.hash == rig.hash
    assert repr(again) == repr(rig)
    assert rig_text(again) == text


@settings(deadline=None, max_examples=30, suppress_health_check=list(HealthCheck))
@given(rigs())
def test_any_rig_is_read_as_it_was_written(rig: Rig) -> None:
    check_same(rig)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_rig_files_of_the_repository_are_read_as_they_were_written(path):
    check_same(load_rig(path))


def test_numbers_of_python_and_numpy_are_written_as_floats(small_rig):
    rig = small_rig.with_values({"coil1.radius_m": np.float64(0.0517), "coil1.axial_loops": 13})
    assert rig_from_text(rig_text(rig)) == rig


def test_what_goes_without_saying_is_not_written(small_rig):
    written = yaml.safe_load(rig_text(small_rig))
    assert set(written) == {"schema_version", "name", "movers", "coils", "sensors"}
    assert written["coils"]["coil1"] == {
        "carried_by": "arm1",
        "radius_mm": {"prior": {"normal": {"mean": 51, "sd": 1}}},
        "wire_radius_mm": 0.98,
        "axial_loops": {"prior": {"normal": {"mean": 12, "sd": 1, "lower": 1}}},
        "radial_loops": 3,
        "world_from_coil0": {"z_mm": {"prior": {"normal": {"mean": -40, "sd": 3}}}},
    }


def test_number_that_no_customary_unit_keeps_is_written_in_si(rig_text_with):
    rig = rig_text_with("wire_radius_m: 0.0013")
    assert 1.3 * 1e-3 != 0.0013
    assert "wire_radius_m: 0.0013" in rig_text(rig)
    assert "wire_radius_mm: 1.3" in rig_text(rig_text_with("wire_radius_mm: 1.3"))


@pytest.fixture
def rig_text_with(rig_text: str) -> Callable[[str], Rig]:
    return lambda line: rig_from_text(rig_text.replace("wire_radius_mm: 0.98", line))


def test_note_stands_at_the_top_and_changes_nothing(small_rig):
    text = rig_text(small_rig, "extended: twice")
    assert text.splitlines()[:2] == ["# extended: twice", "schema_version: 1"]
    assert rig_from_text(text) == small_rig


def test_mistake_in_a_file_that_was_written_is_found_at_its_line(small_rig):
    text = rig_text(small_rig).replace("radius_mm", "radius", 1)
    line = next(n for n, words in enumerate(text.splitlines(), start=1) if "radius:" in words)
    with pytest.raises(
        InvalidInput, match=rf"coils.coil1.radius must carry its unit.*\(rig.yaml, line {line}\)"
    ):
        rig_from_text(text, "rig.yaml")
