"""Sessions and calibrations that were sealed anew after somebody altered them: refused in one sentence, with nothing run or waited for."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path

import google_crc32c
import numpy as np
import pytest
import xarray as xr
import zarr
from hypothesis import given
from hypothesis import strategies as st
from numcodecs.zstd import Zstd

from estimator.calibration.result import SUMMARY_SEAL, Calibration, _tree_hash
from estimator.errors import CoilcalError, CorruptStore
from estimator.store.admission import admit_readings
from estimator.store.chunks import LARGEST_BLOCK, MAGIC, admit_chunk
from estimator.store.growing import StopReadings, new_header
from estimator.store.session import Session, digest, load_session, observation_arrays

pytestmark = pytest.mark.whole

Arrays = dict[str, np.ndarray]
N = 36  # readings of the small session


def refusal(load: Callable[[Path], object], path: Path, kind: type[CoilcalError] = CorruptStore) -> str:
    with pytest.raises(kind) as caught:
        load(path)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 600
    return message


# Sessions whose arrays are no readings


@pytest.fixture(scope="module")
def session_store(small_session: Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stores") / "session.zarr"
    small_session.save(path)
    return path


@pytest.fixture
def session(session_store: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(session_store, tmp_path / "session.zarr"))


def replace_array(session: Path, name: str, data: np.ndarray) -> None:
    """Another array in place of one, with attributes that were sealed anew."""
    group = zarr.open_group(session, mode="r+")
    del group[name]
    names = [f"axis{i}" for i in range(data.ndim)]
    array = group.create_array(
        name, shape=data.shape, dtype=data.dtype, dimension_names=names, compressors=None
    )
    array[...] = data
    seal(session)


def seal(session: Path) -> None:
    node = json.loads((session / "zarr.json").read_text(encoding="utf-8"))
    group = zarr.open_group(session, mode="r")
    arrays = {n: (tuple(a.metadata.dimension_names), np.asarray(a[...])) for n, a in group.arrays()}
    node["attributes"].pop("sha256")
    node["attributes"]["sha256"] = digest(arrays, node["attributes"])
    (session / "zarr.json").write_text(json.dumps(node), encoding="utf-8")


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
def test_arrays_of_another_length_or_type_are_no_readings(
    readings: Arrays, small_session: Session, name: str, change: Callable[[np.ndarray], np.ndarray | None]
) -> None:
    changed = {**readings, name: change(readings[name])}
    arrays = {n: data for n, data in changed.items() if data is not None}
    with pytest.raises(CorruptStore, match=r"must .*; (received|it is missing) .*\(s\.zarr\)"):
        admit_readings(arrays, small_session.rig, "s.zarr")


def test_a_session_with_an_array_that_is_too_short_is_refused(session: Path) -> None:
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
def test_numbers_that_no_reading_has_are_refused(
    readings: Arrays,
    small_session: Session,
    name: str,
    change: Callable[[np.ndarray], np.ndarray],
    message: str,
) -> None:
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
    "truth is no number": ({"truth": {"coil1.radius_m": float("nan")}}, "must tell its truth in finite numbers"),
}  # fmt: skip
RIGS = {
    "no number": ("radial_loops: 3", "radial_loops: .nan", "must be a finite number; received nan (rig inside"),
    "many loops": ("radial_loops: 3", "radial_loops: 1e9", "radial_loops must be at most 5000"),
    "deep": ("name: small", f"name: {'[' * 5000}", "at most 20 levels"),
}  # fmt: skip
VALUES = {
    "no number": (float("nan"), "coil1.radius_m must be finite; received nan"),
    "negative": (-1.0, "coil1.radius_m must be > 0"),
    "a word": ("x", "session must be readable"),
}


def with_attributes(session: Path, changes: dict[str, object]) -> None:
    node = json.loads((session / "zarr.json").read_text(encoding="utf-8"))
    node["attributes"].update(changes)
    (session / "zarr.json").write_text(json.dumps(node), encoding="utf-8")
    seal(session)


@pytest.mark.parametrize(("changes", "message"), WORDS.values(), ids=WORDS)
def test_attributes_of_another_kind_are_refused(
    session: Path, changes: dict[str, object], message: str
) -> None:
    with_attributes(session, changes)
    assert message in refusal(load_session, session)


@pytest.mark.parametrize(("old", "new", "message"), RIGS.values(), ids=RIGS)
def test_a_rig_inside_is_read_as_strictly_as_a_file(session: Path, old: str, new: str, message: str) -> None:
    text = json.loads((session / "zarr.json").read_text(encoding="utf-8"))["attributes"]["rig"]["text"]
    assert old in text
    with_attributes(session, {"rig": {"text": text.replace(old, new)}})
    assert message in refusal(load_session, session, CoilcalError)


@pytest.mark.parametrize(("value", "message"), VALUES.values(), ids=VALUES)
def test_values_inside_a_session_of_version_0_1_follow_the_rules_of_a_rig(
    session: Path, small_session: Session, value: object, message: str
) -> None:
    text = json.loads((session / "zarr.json").read_text(encoding="utf-8"))["attributes"]["rig"]["text"]
    free = [parameter.name for parameter in small_session.rig.free]
    with_attributes(session, {"rig": {"text": text, "values": {"coil1.radius_m": value}, "free": free}})
    assert message in refusal(load_session, session, CoilcalError)


# Folders that zarr should not open


def with_metadata(**changes: object) -> Callable[[Path], None]:
    def change(session: Path) -> None:
        file = session / "time_s" / "zarr.json"
        node = json.loads(file.read_text(encoding="utf-8"))
        file.write_text(json.dumps({**node, **changes}), encoding="utf-8")

    return change


def pipe_in_place_of(name: str) -> Callable[[Path], None]:
    def change(session: Path) -> None:
        (session / name).unlink(missing_ok=True)
        os.mkfifo(session / name)

    return change


def link_to_itself(session: Path) -> None:
    shutil.rmtree(session / "time_s")
    (session / "time_s").symlink_to(session)


FOLDERS = {
    "a pipe as chunk": (pipe_in_place_of("time_s/c/0"), "must hold files and folders only"),
    "a pipe as metadata": (pipe_in_place_of("time_s/zarr.json"), "must hold files and folders only"),
    "a pipe beside the arrays": (pipe_in_place_of("notes.txt"), "must hold files and folders only"),
    "a link to itself": (link_to_itself, "must hold files and folders only"),
    "format 2 beside format 3": (lambda s: (s / ".zgroup").write_text("{}"), "must be of zarr format 3"),
    "format 2 in the metadata": (with_metadata(zarr_format=2), "must be of zarr format 3"),
    "another codec": (with_metadata(codecs=[{"name": "numcodecs.zlib"}]), "must use the codecs bytes, zstd, crc32c only"),
    "codecs in another order": (
        with_metadata(codecs=[{"name": "bytes"}, {"name": "crc32c"}, {"name": "zstd"}]),
        "must use the codecs bytes, zstd, crc32c only, in this order",
    ),
    "zstd twice": (
        with_metadata(codecs=[{"name": "bytes"}, {"name": "zstd"}, {"name": "zstd"}]),
        "must use the codecs bytes, zstd, crc32c only, in this order",
    ),
    "chunks by other names": (
        with_metadata(chunk_key_encoding={"name": "v2", "configuration": {"separator": "."}}),
        "must name its chunks by folders",
    ),
    "pickle": (with_metadata(codecs=[{"name": "numcodecs.pickle"}]), "must use the codecs bytes, zstd, crc32c only"),
    "objects": (with_metadata(data_type="object"), "must hold arrays of bool, int64, float64; "),
    "1e13 numbers": (with_metadata(shape=[10**13]), "must hold at most 300000000 numbers"),
    "a chunk of 1e13": (
        with_metadata(chunk_grid={"name": "regular", "configuration": {"chunk_shape": [10**13]}}),
        "must hold at most 300000000 numbers",
    ),
    "deep metadata": (lambda s: (s / "time_s/zarr.json").write_text("[" * 100_000), "session must be readable"),
    "a list as metadata": (lambda s: (s / "time_s/zarr.json").write_text("[]"), "session must be readable"),
    "long metadata": (lambda s: (s / "zarr.json").write_text(" " * 8_000_001), "metadata of at most 8000000 bytes"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), FOLDERS.values(), ids=FOLDERS)
def test_a_folder_is_looked_at_before_zarr_opens_it(
    session: Path, change: Callable[[Path], None], message: str
) -> None:
    change(session)
    assert message in refusal(load_session, session)


# Chunks that unfold to another size than their array has; the decoder alone would follow them


def frame_of(data: bytes) -> bytes:
    return bytes(Zstd(level=3).encode(data))


def with_chunk(frame: bytes) -> Callable[[Path], None]:
    """A chunk with the right CRC-32C in place of the times, which are 36 numbers of 8 bytes."""

    def change(session: Path) -> None:
        content = frame + google_crc32c.value(frame).to_bytes(4, "little")
        (session / "time_s" / "c" / "0").write_bytes(content)

    return change


def sparse(session: Path) -> None:
    with (session / "time_s" / "c" / "0").open("wb") as file:
        file.truncate(1 << 40)


ONE = frame_of(b"\0" * 8 * N)
LARGE = frame_of(b"\0" * (1 << 26))
BLOCKS = [((LARGEST_BLOCK << 3) | 2 | (i == 99)).to_bytes(3, "little") + b"\0" for i in range(100)]
EMPTY_BLOCKS = b"\0\0\0" * 1000 + b"\1\0\0"
CHUNKS = {
    "64 MB": LARGE,
    "64 MB in a second frame": ONE + LARGE,
    "64 MB after an empty frame": frame_of(b"") + LARGE,
    "64 MB after a skipped frame": b"\x50\x2a\x4d\x18\4\0\0\0abcd" + LARGE,
    "13 MB in a frame that does not say so": MAGIC + b"\x00\x38" + b"".join(BLOCKS),
    "many empty blocks": MAGIC + b"\x60" + (8 * N - 256).to_bytes(2, "little") + EMPTY_BLOCKS,
    "too short": frame_of(b"\0" * 8),
    "half a frame": ONE[: len(ONE) // 2],
    "half a header": MAGIC,
    "no frame": b"\0" * 8 * N,
    "nothing": b"",
}


@pytest.mark.parametrize("frame", CHUNKS.values(), ids=CHUNKS)
def test_a_chunk_of_another_size_is_not_decoded(
    session: Path, frame: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    with_chunk(frame)(session)
    monkeypatch.setattr(zarr, "open_group", None)
    assert "must hold chunks of the size that its arrays have; " in refusal(load_session, session)


def test_a_chunk_of_a_terabyte_of_holes_is_not_read(session: Path) -> None:
    sparse(session)
    assert "is no chunk of 288 bytes" in refusal(load_session, session)


def test_a_chunk_without_zstd_is_as_long_as_it_should_be(session: Path) -> None:
    replace_array(session, "repeat", np.ones(N, int))
    load_session(session)
    with (session / "repeat" / "c" / "0").open("ab") as file:
        file.write(b"\0")
    assert "is no chunk of 288 bytes" in refusal(load_session, session)


@given(st.binary(max_size=60), st.booleans())
def test_any_bytes_are_one_frame_of_the_right_size_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, is_frame: bool
) -> None:
    """What is admitted is what the decoder makes of it."""
    file = tmp_path_factory.getbasetemp() / "any chunk"
    file.write_bytes(frame_of(data) if is_frame else MAGIC + data)
    try:
        admit_chunk(file, len(data), ["bytes", "zstd"], "session")
    except CorruptStore:
        assert not is_frame
    else:
        assert is_frame


@pytest.mark.parametrize("size", [0, 1, 255, 256, 257, 65_791, 65_792, 200_000, 3_000_000])
def test_frames_of_every_size_are_admitted(tmp_path: Path, size: int) -> None:
    random = np.random.default_rng(size).bytes(size)
    for data in (random, b"\0" * size):
        (tmp_path / "chunk").write_bytes(frame_of(data))
        admit_chunk(tmp_path / "chunk", size, ["bytes", "zstd"], "session")
        with pytest.raises(CorruptStore):
            admit_chunk(tmp_path / "chunk", size + 1, ["bytes", "zstd"], "session")


# Sessions that are being measured

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
HEADERS = {
    "no rig": {"rig": None},
    "a time in numbers": {"created": 5},
    "no source": {"source": None},
}
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
def test_a_stop_of_another_shape_is_refused(
    small_session: Session, tmp_path: Path, changes: dict[str, object]
) -> None:
    header = new_header(small_session.rig, "by hand", "plan", {})
    write_journal(tmp_path / "s.zarr", header, {**STOP, **changes}, STOP)
    refusal(load_session, tmp_path / "s.zarr")


@pytest.mark.parametrize("changes", HEADERS.values(), ids=HEADERS)
def test_a_header_of_another_shape_is_refused(
    small_session: Session, tmp_path: Path, changes: dict[str, object]
) -> None:
    write_journal(
        tmp_path / "s.zarr", {**new_header(small_session.rig, "by hand", "plan", {}), **changes}, STOP
    )
    refusal(load_session, tmp_path / "s.zarr")


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_a_line_that_is_no_entry_is_refused(small_session: Session, tmp_path: Path, line: bytes) -> None:
    write_journal(tmp_path / "s.zarr", new_header(small_session.rig, "by hand", "plan", {}), line)
    assert "must hold an entry in each line; line 2 of" in refusal(load_session, tmp_path / "s.zarr")


# Calibrations


@pytest.fixture
def calibration(small_calibration: Calibration, tmp_path: Path) -> Path:
    small_calibration.save(tmp_path / "calibration")
    return tmp_path / "calibration"


def without_seal(calibration: Path, change: Callable[[xr.DataTree], object] = lambda _: None) -> None:
    """A posterior that was altered and hashed anew, without the seal of its summary, as versions before wrote it."""
    store = calibration / "posterior.zarr"
    with xr.open_datatree(store, engine="zarr", consolidated=False) as tree:
        tree.load()
    for key in ("sha256", SUMMARY_SEAL):
        tree.attrs.pop(key)
    change(tree)
    tree.attrs["sha256"] = _tree_hash(tree)
    shutil.rmtree(store)
    tree.to_zarr(store, mode="w", zarr_format=3, consolidated=False)


def test_any_changed_byte_of_a_summary_is_found(calibration: Path) -> None:
    file = calibration / "summary.json"
    content = file.read_bytes()
    random = np.random.default_rng(1)
    for bit in random.choice(8 * len(content), 20, replace=False):
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << (bit % 8)
        file.write_bytes(damaged)
        assert str(calibration) in refusal(Calibration.load, calibration)
    file.write_bytes(content)
    Calibration.load(calibration)


def test_a_summary_of_another_calibration_is_found(calibration: Path, small_calibration: Calibration) -> None:
    other = json.loads(json.dumps(small_calibration.summary())) | {"seed": 12}
    (calibration / "summary.json").write_text(json.dumps(other, indent=2) + "\n", encoding="utf-8")
    assert "was altered, or belongs to another posterior" in refusal(Calibration.load, calibration)


def test_a_calibration_from_before_the_seal_opens(calibration: Path, small_calibration: Calibration) -> None:
    without_seal(calibration)
    assert Calibration.load(calibration).best == small_calibration.best


SUMMARIES = {
    "list": "[1, 2]",
    "null": "null",
    "nothing": "",
    "a number": "5",
    "text": '"x"',
    "{}": "{}",
    "depth": "[" * 100_000,
}


@pytest.mark.parametrize("text", SUMMARIES.values(), ids=SUMMARIES)
@pytest.mark.parametrize("is_sealed", [True, False])
def test_a_summary_that_is_none_is_refused(calibration: Path, text: str, is_sealed: bool) -> None:
    if not is_sealed:
        without_seal(calibration)
    (calibration / "summary.json").write_text(text, encoding="utf-8")
    refusal(Calibration.load, calibration)


@pytest.mark.parametrize(
    "key", ["parameters", "rmse", "coverage90", "sampling", "loop_counts", "undetermined", "truth"]
)
def test_a_summary_from_before_the_seal_has_what_pages_read(calibration: Path, key: str) -> None:
    without_seal(calibration)
    summary = json.loads((calibration / "summary.json").read_text(encoding="utf-8"))
    for changed in ({**summary, key: None}, {k: v for k, v in summary.items() if k != key}):
        (calibration / "summary.json").write_text(json.dumps(changed), encoding="utf-8")
        refusal(Calibration.load, calibration)


def with_best(value: object) -> Callable[[xr.DataTree], None]:
    def change(tree: xr.DataTree) -> None:
        tree.attrs["best"] = json.dumps({**json.loads(tree.attrs["best"]), "coil1.radius_m": value})

    return change


def with_draws(value: float) -> Callable[[xr.DataTree], None]:
    def change(tree: xr.DataTree) -> None:
        tree["posterior"]["coil1.radius_m"].to_numpy()[3] = value

    return change


def few_draws(tree: xr.DataTree) -> None:
    dataset = tree["posterior"].to_dataset().drop_vars("coil1.radius_m")
    tree["posterior"] = xr.DataTree(dataset.assign({"coil1.radius_m": (("a", "b"), np.zeros((2, 2)))}))


POSTERIORS = {
    "a best value that is no number": (with_best(float("nan")), "best coil1.radius_m must be finite; received nan"),
    "a best value in words": (with_best("x"), "calibration must be readable"),
    "a list of best values": (lambda t: t.attrs.update(best="[1]"), "calibration must be readable"),
    "no best values": (lambda t: t.attrs.update(best="{}"), "calibration must be readable"),
    "draws that are no numbers": (with_draws(np.nan), "draws of coil1.radius_m must be finite and of shape"),
    "few draws": (few_draws, "draws of coil1.radius_m must be finite and of shape"),
    "a parameter without draws": (lambda t: t["posterior"].__delitem__("coil1.radius_m"), "must be readable"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), POSTERIORS.values(), ids=POSTERIORS)
def test_a_posterior_that_predicts_nothing_is_refused(
    calibration: Path, change: Callable[[xr.DataTree], object], message: str
) -> None:
    without_seal(calibration, change)
    assert message in refusal(Calibration.load, calibration)


class Touch:
    """Runs a command of the shell where it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, (f"touch {self.path}",)


def test_format_2_with_pickled_objects_is_not_unpickled(calibration: Path, tmp_path: Path) -> None:
    store = calibration / "posterior.zarr"
    shutil.rmtree(store)
    (store / "posterior" / "x").mkdir(parents=True)
    for folder in (store, store / "posterior"):
        (folder / ".zgroup").write_text('{"zarr_format": 2}', encoding="utf-8")
    node = {"zarr_format": 2, "shape": [1], "chunks": [1], "dtype": "|O", "order": "C", "fill_value": None}
    node |= {"compressor": None, "filters": [{"id": "pickle", "protocol": 4}]}
    (store / "posterior" / "x" / ".zarray").write_text(json.dumps(node), encoding="utf-8")
    (store / "posterior" / "x" / "0").write_bytes(pickle.dumps(Touch(tmp_path / "run")))
    assert "calibration must be of zarr format 3" in refusal(Calibration.load, calibration)
    assert not (tmp_path / "run").exists()
