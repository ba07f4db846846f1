"""Sessions whose arrays or attributes are no readings, though they were sealed anew: refused in one sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from estimator.errors import CoilcalError, CorruptStore
from estimator.store.admission import admit_readings
from estimator.store.arrays import observation_arrays
from estimator.store.session import Session, load_session
from tests.estimator.attack.conftest import N, refusal, replace_array, seal

pytestmark = pytest.mark.whole

Arrays = dict[str, np.ndarray]


def with_value(index: int, value: float) -> Callable[[np.ndarray], np.ndarray]:
    def changed(array: np.ndarray) -> np.ndarray:
        array = array.copy()
        array[index] = value
        return array

    return changed


EVERY_ARRAY = (
    "time_s",
    "sensor_index",
    "current_A",
    "field_sensor_T",
    "is_validation",
    "repeat",
    "motion_arm1",
)
SHAPES = {
    "shorter": lambda a: a[:-3],
    "longer": lambda a: np.concatenate((a, a)),
    "empty": lambda a: a[:0],
    "another axis": lambda a: a[..., None],
    "single precision": lambda a: a.astype("f4"),
    "complex": lambda a: a.astype("c16"),
    "missing": lambda _: None,
}


@pytest.fixture(scope="module")
def readings(small_session: Session) -> Arrays:
    return {name: data for name, (_, data) in observation_arrays(small_session.observations).items()}


@pytest.mark.parametrize("change", SHAPES.values(), ids=SHAPES)
@pytest.mark.parametrize("name", EVERY_ARRAY)
def test_arrays_of_another_length_or_type_are_no_readings(readings, small_session, name, change):
    changed = {**readings, name: change(readings[name])}
    arrays = {n: data for n, data in changed.items() if data is not None}
    with pytest.raises(CorruptStore, match=r"must .*; (received|it is missing) .*\(s\.zarr\)"):
        admit_readings(arrays, small_session.rig, "s.zarr")


def test_a_session_with_an_array_that_is_too_short_is_refused(session):
    replace_array(session, "repeat", np.zeros(3, int))
    assert "repeat must be int64 of shape (36,); received int64 of shape (3,)" in refusal(
        load_session, session
    )


NUMBERS = {
    "sensor 7": ("sensor_index", with_value(0, 7), "sensor_index must lie between 0 and 0; received 7"),
    "sensor -1": ("sensor_index", with_value(0, -1), "sensor_index must lie between 0 and 0; received -1"),
    "sensor 2^62": ("sensor_index", with_value(0, 2**62), "sensor_index must lie between 0 and 0"),
    "repeat -5": ("repeat", with_value(0, -5), "repeat must lie between 0 and 1e+09; received -5"),
    "a late time": ("time_s", with_value(3, 1e300), "time_s must lie between -1e+12 and 1e+12; received 1e+300"),
    "a far position": ("motion_arm1", with_value(3, -1e300), "motion_arm1 must lie between"),
    "an endless current": ("current_A", with_value(3, np.inf), "current_A must lie between"),
    "few segments": ("segment", lambda _: np.zeros(3, int), "segment must be int64 of shape (36,)"),
    "half segments": ("segment", lambda _: np.zeros(N), "segment must be int64 of shape (36,); received float64"),
    "a far segment": ("segment", lambda _: np.full(N, 10**15), "segment must lie between -1 and 1e+09"),
    "few temperatures": ("temperature_hall_C", lambda _: np.zeros(3), "temperature_hall_C must be float64 of shape"),
    "a hot coil": ("temperature_hall_C", lambda _: np.full(N, np.inf), "temperature_hall_C must lie between"),
    "currents of two": ("current_measured_A", lambda _: np.zeros((N, 2)), "current_measured_A must be float64 of shape"),
}  # fmt: skip


@pytest.mark.parametrize(("name", "change", "message"), NUMBERS.values(), ids=NUMBERS)
def test_numbers_that_no_reading_has_are_refused(readings, small_session, name, change, message):
    with pytest.raises(CorruptStore) as caught:
        admit_readings(
            {**readings, name: change(readings.get(name, np.zeros(0)))}, small_session.rig, "s.zarr"
        )
    assert message in str(caught.value)


# Sessions whose attributes are none

WORDS = {
    "rig is a list": ({"rig": [1]}, "session must be readable"),
    "rig is nothing": ({"rig": None}, "session must be readable"),
    "rig is a number": ({"rig": {"text": 5}}, "session must be readable"),
    "time is a list": ({"created": [1]}, "must tell its source and time in words"),
    "source is nothing": ({"source": None}, "must tell its source and time in words"),
    "truth is a list": ({"truth": [1]}, "session must be readable"),
    "truth is text": ({"truth": {"coil1.radius_m": "x"}}, "must tell its truth in finite numbers"),
    "truth is no number": ({"truth": {"coil1.radius_m": float("nan")}}, "NaN is no finite number"),
}  # fmt: skip
RIGS = {
    "no number": ("radial_loops: 3", "radial_loops: .nan", "must be a finite number; received nan (rig inside"),
    "many loops": ("radial_loops: 3", "radial_loops: 1e9", "radial_loops must be at most 5000"),
    "deep": ("name: small", f"name: {'[' * 5000}", "at most 20 levels"),
}  # fmt: skip
VALUES = {
    "no number": (float("nan"), "NaN is no finite number"),
    "negative": (-1.0, "coil1.radius_m must be > 0"),
    "a word": ("x", "session must be readable"),
}


def with_attributes(session: Path, changes: dict[str, object]) -> None:
    node = json.loads((session / "zarr.json").read_text(encoding="utf-8"))
    node["attributes"].update(changes)
    (session / "zarr.json").write_text(json.dumps(node), encoding="utf-8")
    seal(session)


@pytest.mark.parametrize(("changes", "message"), WORDS.values(), ids=WORDS)
def test_attributes_of_another_kind_are_refused(session, changes, message):
    with_attributes(session, changes)
    assert message in refusal(load_session, session)


@pytest.mark.parametrize(("old", "new", "message"), RIGS.values(), ids=RIGS)
def test_a_rig_inside_is_read_as_strictly_as_a_file(session, old, new, message):
    text = json.loads((session / "zarr.json").read_text(encoding="utf-8"))["attributes"]["rig"]["text"]
    assert old in text
    with_attributes(session, {"rig": {"text": text.replace(old, new)}})
    assert message in refusal(load_session, session, CoilcalError)


@pytest.mark.parametrize(("value", "message"), VALUES.values(), ids=VALUES)
def test_values_inside_a_session_of_version_0_1_follow_the_rules_of_a_rig(
    session, small_session, value, message
):
    text = json.loads((session / "zarr.json").read_text(encoding="utf-8"))["attributes"]["rig"]["text"]
    free = [parameter.name for parameter in small_session.rig.free]
    with_attributes(session, {"rig": {"text": text, "values": {"coil1.radius_m": value}, "free": free}})
    assert message in refusal(load_session, session, CoilcalError)
