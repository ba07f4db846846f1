"""Sessions on disk: equal when read back, open to plain xarray, and never silently wrong, half-written or lost."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import xarray as xr

from estimator.errors import CorruptStore, InvalidInput
from estimator.readings.observations import Observations
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.session import Session, load_session
from tests.estimator.store.damaged import cut, files, flipped, lost

pytestmark = pytest.mark.whole  # hundreds of sessions are written and read

RIG = """\
schema_version: 1
name: two of each
movers: {arm: {motion: UR3}, stage: {motion: pose}}
coils:
  coil1: {carried_by: arm, radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}
  coil2: {radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}
sensors: {hall_a: {noise_uT: 20}, hall_b: {carried_by: stage, noise_uT: 20}}
"""
N = 40


def make_session(rig: Rig | None = None) -> Session:
    random = torch.Generator().manual_seed(1)

    def numbers(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=random, dtype=torch.float64) / 3.0

    field_T = numbers(N, 3)
    field_T[3, 1] = field_T[7, :2] = math.nan
    observations = Observations(
        numbers(N),
        torch.randint(2, (N,), generator=random),
        numbers(N, 2),
        {"arm": numbers(N, 6), "stage": numbers(N, 6)},
        field_T,
        numbers(N) > 0.2,
        torch.randint(4, (N,), generator=random),
        {"coil2": numbers(N), "hall_a": numbers(N)},
        current_measured_A=numbers(N, 2),
    )
    return Session(rig or rig_from_text(RIG), observations, "by hand", truth={"coil1.radius_m": 0.05})


@pytest.fixture
def session() -> Session:
    return make_session()


@pytest.fixture
def store(session: Session, tmp_path: Path) -> Path:
    session.save(tmp_path / "session.zarr")
    return tmp_path / "session.zarr"


def assert_equal(loaded: Session, expected: Session) -> None:
    """Equal in every number and word, NaN included."""
    assert loaded.rig == expected.rig
    for name in ("source", "created", "truth"):
        assert getattr(loaded, name) == getattr(expected, name)
    a, b = dict(vars(loaded.observations)), dict(vars(expected.observations))
    for name in ("rows_late", "late_since_h"):
        assert a.pop(name) == b.pop(name)
    for name in set(a) - {"whole", "chosen"}:  # these describe a subset; a session holds all its readings
        for tensor, expected_tensor in zip(tensors(a[name]), tensors(b[name]), strict=True):
            assert tensor.dtype == expected_tensor.dtype
            torch.testing.assert_close(tensor, expected_tensor, rtol=0.0, atol=0.0, equal_nan=True)


def tensors(value: torch.Tensor | dict[str, torch.Tensor] | None) -> list[torch.Tensor]:
    if value is None:
        return []
    return [value] if isinstance(value, torch.Tensor) else [value[key] for key in sorted(value)]


def test_a_session_is_read_back_equal(session, store):
    assert_equal(load_session(store), session)
    assert load_session(str(store)).hash == session.hash


def test_measured_currents_are_in_a_session_if_they_were_measured(session, tmp_path):
    without = replace(session, observations=replace(session.observations, current_measured_A=None))
    assert without.hash != session.hash
    without.save(tmp_path / "without.zarr")
    assert_equal(load_session(tmp_path / "without.zarr"), without)
    for saved, is_there in ((session, True), (without, False)):
        readings = saved.observations
        parts = readings.rows(torch.arange(9)).alone, readings.rows(torch.arange(9, N)).alone
        assert (parts[0].followed_by(parts[1]).current_measured_A is not None) is is_there
    assert parts[0].followed_by(session.observations).current_measured_A is None


def test_segments_are_in_a_session_if_they_were_recorded(session, tmp_path):
    recorded = replace(session.observations, recorded_segment=torch.arange(N) // 13)
    divided = replace(session, observations=recorded)
    assert divided.hash != session.hash
    divided.save(tmp_path / "divided.zarr")
    assert_equal(load_session(tmp_path / "divided.zarr"), divided)


def test_values_that_were_set_or_fixed_after_reading_the_rig_are_stored(tmp_path):
    free = rig_from_text(
        RIG.replace("noise_uT: 20}, ", "noise_uT: {prior: {uniform: {lower: 1, upper: 50}}}}, ")
    )
    fixed = free.with_values({"coil1.radius_m": 0.0601}).with_fixed(["hall_a.noise_T"])
    assert len(free.free) == 1
    session = make_session(fixed)
    session.save(tmp_path / "s.zarr")
    assert load_session(tmp_path / "s.zarr").rig == fixed
    assert (
        len({session.hash, make_session(free).hash, make_session(free.with_fixed(["hall_a.noise_T"])).hash})
        == 3
    )


def test_the_hash_depends_on_readings_and_rig_only(session):
    assert make_session().hash == session.hash
    assert replace(session, source="elsewhere", created="2025-01-01", truth={}).hash == session.hash
    o = session.observations
    for changed in (
        replace(o, time_s=o.time_s + 1.0),
        replace(o, repeat=o.repeat + 1),
        replace(o, motion={**o.motion, "arm": -o.motion["arm"]}),
        replace(o, temperature_C={}),
        o.with_field(-o.field_sensor_T),
        o.with_validation(~o.is_validation),
    ):
        assert replace(session, observations=changed).hash != session.hash
    changed_rig = rig_from_text(RIG.replace("wire_radius_mm: 1,", "wire_radius_mm: 1.1,"))
    assert replace(session, rig=changed_rig).hash != session.hash


def test_plain_xarray_opens_it_with_named_dimensions(session, store):
    with xr.open_zarr(store, consolidated=False) as dataset:
        dims = {name: array.dims for name, array in dataset.data_vars.items()}
        assert dims == {
            "time_s": ("reading",),
            "sensor_index": ("reading",),
            "current_A": ("reading", "coil"),
            "field_sensor_T": ("reading", "component"),
            "is_validation": ("reading",),
            "repeat": ("reading",),
            "motion_arm": ("reading", "axis"),
            "motion_stage": ("reading", "axis"),
            "current_measured_A": ("reading", "coil"),
            "temperature_coil2_C": ("reading",),
            "temperature_hall_a_C": ("reading",),
        }
        np.testing.assert_array_equal(dataset["field_sensor_T"], session.observations.field_sensor_T.numpy())
        assert (dataset.attrs["coil"], dataset.attrs["sensor"]) == (["coil1", "coil2"], ["hall_a", "hall_b"])
        assert dataset.attrs["schema_version"] == 1


def test_every_chunk_is_checksummed(store):
    for name in (path.parent for path in store.glob("*/zarr.json")):
        codecs = json.loads((name / "zarr.json").read_text(encoding="utf-8"))["codecs"]
        assert [codec["name"] for codec in codecs][-2:] == ["zstd", "crc32c"]


def test_a_flipped_bit_is_found_or_changes_nothing(session, store):
    n_detected = 0
    for path in flipped(store, 8):
        try:
            assert_equal(load_session(store), session)
        except (CorruptStore, InvalidInput):
            n_detected += 1
        else:
            assert path.name == "zarr.json"  # an equivalent layout, such as another fill value
    assert n_detected > 0.9 * 8 * len(files(store))
    assert_equal(load_session(store), session)


def test_every_changed_letter_of_the_attributes_is_found(session, store):
    """Including attributes on which no array depends: source, truth, the rig's text and values, the order of coils."""
    group = store / "zarr.json"
    content = group.read_text(encoding="utf-8")
    words = (
        "by hand",
        "two of each",
        "0.05",
        "wire_radius_mm: 1",
        "hall_b",
        session.created,
        '"schema_version": 1',
        "sha256",
    )
    for word in words:
        assert word in content, word
        position = content.index(word)
        letter = "9" if content[position] != "9" else "8"
        group.write_text(content[:position] + letter + content[position + 1 :], encoding="utf-8")
        with pytest.raises(CorruptStore):
            load_session(store)


def test_any_lost_file_is_found(store):
    for path in lost(store):
        with pytest.raises(InvalidInput if path == store / "zarr.json" else CorruptStore):
            load_session(store)


@pytest.mark.filterwarnings("error")
def test_a_truncated_file_is_found(store):
    for _ in cut(store):
        with pytest.raises(CorruptStore, match=r"session must .*session\.zarr|session\.zarr/.* must be JSON"):
            load_session(store)


def test_notes_beside_the_arrays_are_tolerated(session, store):
    (store / "notes.txt").write_text("the coil was warm", encoding="utf-8")
    (store / "photos").mkdir()
    assert_equal(load_session(store), session)


def altered(store: Path, key: str, value: object) -> None:
    group = json.loads((store / "zarr.json").read_text(encoding="utf-8"))
    group["attributes"][key] = value
    (store / "zarr.json").write_text(json.dumps(group), encoding="utf-8")


def test_another_schema_version_is_refused(store):
    altered(store, "schema_version", 2)
    with pytest.raises(CorruptStore, match="session schema_version must be 1; received 2"):
        load_session(store)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "coil2:",
            "coil3:",
            "coils of the rig must be those of the session (coil1, coil2); received coil1, coil3",
        ),
        (
            "hall_a:",
            "hall_c:",
            "sensors of the rig must be those of the session (hall_a, hall_b); received hall_c, hall_b",
        ),
        (
            "motion: UR3}",
            "motion: UR3e}",
            "movers of the rig must be those of the session (arm (UR3), stage (pose)); "
            "received arm (UR3e), stage (pose)",
        ),
    ],
)
def test_a_rig_with_other_coils_sensors_or_movers_is_refused(session, old, new, message):
    with pytest.raises(InvalidInput) as caught:
        session.check_rig(rig_from_text(RIG.replace(old, new)))
    assert str(caught.value) == f"{message} (rig 'two of each')"
    session.check_rig(rig_from_text(RIG.replace("radius_mm: 50", "radius_mm: 49")))
