"""Sessions that are being measured, with lines that no measurement writes."""

from __future__ import annotations

import json
import zlib
from pathlib import Path

import pytest

from estimator.store.growing import StopReadings, new_header
from estimator.store.session import load_session
from tests.estimator.attack.conftest import refusal

pytestmark = pytest.mark.whole


STOPS = {
    "two currents": {"current_A": [1.0, 2.0]},
    "a current in words": {"current_A": ["x"]},
    "five numbers of a pose": {"motion": {"arm1": [0.0] * 5}},
    "no pose": {"motion": {}},
    "two components": {"field_T": {"hall": [0.0, 0.0]}},
    "a field in words": {"field_T": {"hall": ["a", "b", "c"]}},
    "no time": {"time_s": None},
    "a late time": {"time_s": 1e300},
    "a repeat of 10^30": {"repeat": 10**30},
    "a negative repeat": {"repeat": -1},
    "a temperature in words": {"temperature_C": {"hall": "x"}},
    "a measured current in words": {"measured_A": {"coil1": "x"}},
}
HEADERS = {"no rig": {"rig": None}, "a time in numbers": {"created": 5}, "no source": {"source": None}}
LINES = {"a list": b"[1]", "nothing": b"null", "a number": b"7", "depth": b'{"n": 1, "a": ' + b"[" * 100_000}


def write_journal(path: Path, header: dict[str, object], *entries: dict[str, object] | bytes) -> None:
    """A journal with the right checksums."""
    texts = [
        entry if isinstance(entry, bytes) else json.dumps({"n": n, **entry}).encode()
        for n, entry in enumerate((header, *entries))
    ]
    path.mkdir()
    (path / "journal.jsonl").write_bytes(b"".join(b"%08x %s\n" % (zlib.crc32(text), text) for text in texts))


STOP = StopReadings(0.0, (3.0,), {"arm1": [0.0] * 6}, {"hall": (1e-3, 0.0, 0.0)}, False, 0).entry()


@pytest.mark.parametrize("changes", STOPS.values(), ids=STOPS)
def test_a_stop_of_another_shape_is_refused(small_session, tmp_path, changes):
    header = new_header(small_session.rig, "by hand", "plan", {})
    write_journal(tmp_path / "s.zarr", header, {**STOP, **changes}, STOP)
    refusal(load_session, tmp_path / "s.zarr")


@pytest.mark.parametrize("changes", HEADERS.values(), ids=HEADERS)
def test_a_header_of_another_shape_is_refused(small_session, tmp_path, changes):
    write_journal(
        tmp_path / "s.zarr", {**new_header(small_session.rig, "by hand", "plan", {}), **changes}, STOP
    )
    refusal(load_session, tmp_path / "s.zarr")


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_a_line_that_is_no_entry_is_refused(small_session, tmp_path, line):
    write_journal(tmp_path / "s.zarr", new_header(small_session.rig, "by hand", "plan", {}), line)
    message = refusal(load_session, tmp_path / "s.zarr")
    assert "line 2 must " in message
    assert "JSON" in message
