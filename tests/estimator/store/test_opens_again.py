"""Whatever stands in a file of readings: it is refused in one sentence, or the session that is made of it opens again."""

from __future__ import annotations

import math
import tempfile
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from estimator.errors import InvalidInput
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.importers.readings_csv import read_readings_csv
from estimator.store.session import Session, load_session

pytestmark = pytest.mark.whole  # hundreds of sessions are written and read

COLUMNS = {
    "t_s": "1",
    "sensor": "hall",
    "coil1_current_A": "3",
    "arm1_x_m": "0.01",
    "arm1_y_m": "0.02",
    "arm1_z_um": "0.03",
    "arm1_rx_rad": "0",
    "arm1_ry_deg": "0",
    "arm1_rz_rad": "0",
    "Bx_T": "1e-3",
    "By_mT": "2",
    "Bz_G": "3",
    "set": "validation",
    "repeat": "1",
    "segment": "2",
    "recorded_at": "2025-03-02",
    "coil1_temperature_C": "21",
    "hall_temperature_C": "22",
}
NUMBERS = st.one_of(
    st.floats().map(repr),
    st.integers().map(str),
    st.sampled_from(
        ["1e300", "-1e300", "1e-320", "1e12", "1.0001e12", "1e999", "9" * 5000, "", " ", "0x1p9", "1_0", "١"]
    ),
)
CELLS = st.one_of(
    NUMBERS,
    st.text(max_size=8),
    st.sampled_from(['"', '""', '"a', 'a"b', '"a"b', '"1"', "1,", "\0", "\r", "\n"]),
)


def rig() -> Rig:
    return rig_from_text(
        "schema_version: 1\nname: one\nmovers: {arm1: {motion: displacement}}\nsensors: {hall: {noise_uT: 20}}\n"
        "coils: {coil1: {carried_by: arm1, radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}}\n"
    )


@settings(max_examples=150)
@given(st.sampled_from(list(COLUMNS)), CELLS)
@example("t_s", "1e300")
@example("hall_temperature_C", "-1e13")
@example("sensor", '"hall')
def test_a_cell_is_refused_in_one_sentence_or_the_session_opens_again(column: str, cell: str) -> None:
    row = {**COLUMNS, column: cell}
    other = {**COLUMNS, "t_s": "0", "set": "calibration"}
    with tempfile.TemporaryDirectory() as folder:
        path, out = Path(folder) / "readings.csv", Path(folder) / "session.zarr"
        lines = [",".join(COLUMNS), ",".join(other.values()), ",".join(row.values())]
        path.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="replace")
        session, fault = read_and_saved(path, out)
        if session is not None:
            assert len(session.observations) == 2
            assert load_session(out).hash == session.hash
        else:
            assert "\n" not in fault
            assert len(fault) < 600
            assert not out.exists()


def read_and_saved(path: Path, out: Path) -> tuple[Session | None, str]:
    try:
        session = read_readings_csv(path, rig())
        session.save(out)
    except InvalidInput as fault:
        return None, str(fault)
    return session, ""


@pytest.mark.parametrize("name", ["time_s", "current_A", "field_sensor_T", "repeat", "sensor", "motion"])
def test_readings_that_could_not_be_opened_are_not_written(small_session, tmp_path, name):
    """However they came about, and not only by a file that is read cell by cell."""
    readings = small_session.observations
    if name == "motion":
        changed = replace(readings, motion={"arm1": readings.motion["arm1"] * 1e200})
    else:
        values = getattr(readings, name)
        changed = replace(
            readings,
            **{name: torch.full_like(values, 10**10) if values.dtype == torch.int64 else values * 1e200},
        )
    with pytest.raises(InvalidInput, match="must lie between") as caught:
        replace(small_session, observations=changed).save(tmp_path / "session.zarr")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_truth_that_is_no_number_is_not_written(small_session, tmp_path):
    with pytest.raises(InvalidInput, match="must tell its truth in finite numbers"):
        replace(small_session, truth={"coil1.radius_m": math.inf}).save(tmp_path / "session.zarr")
    assert list(tmp_path.iterdir()) == []
