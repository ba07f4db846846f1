"""JSON from a file is what coilcal can have written, or refused in one sentence; a seal sees every altered byte."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from estimator.errors import CorruptStore, InvalidInput
from estimator.json_files import json_object, json_of, read_json, sealed, unsealed

REFUSED = {
    "nothing": (b"", "must be JSON; expecting value at column 1"),
    "no JSON": (
        b"{\n'a': 1}",
        "must be JSON; expecting property name enclosed in double quotes at line 2, column 1",
    ),
    "more behind": (b"{} {}", "must be JSON; extra data at column 4"),
    "NaN": (b'{"a": NaN}', "NaN is no finite number"),
    "infinity": (b'{"a": -Infinity}', "-Infinity is no finite number"),
    "a number that overflows": (b'{"a": 1e999}', "1e999 is no finite number"),
    "thousands of digits": (b'{"a": ' + b"9" * 5000 + b"}", "must be JSON; "),
    "a key twice": (b'{"a": 1, "b": 2, "a": 3}', "key 'a' is given twice"),
    "a key twice below": (b'{"x": [{"a": 1, "a": 1}]}', "key 'a' is given twice"),
    "half a character": (b'{"a": "\\ud800"}', "must be JSON of whole characters"),
    "half a character as key": (b'{"\\uDfff": 1}', "must be JSON of whole characters"),
    "open lists": (b"[" * 1_000_000, "at most 100 levels"),
    "closed lists": (b"[" * 101 + b"]" * 101, "at most 100 levels"),
    "another encoding": (
        '{"a": "µ"}'.encode("latin-1"),
        "must be readable as text: 'utf-8' has no byte 0xb5, as in line 1",
    ),
    "UTF-16": ('{"a": 1}'.encode("utf-16"), "it is in UTF-16"),
}
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(10**20), 10**20)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(blacklist_categories=["Cs"])),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(st.characters(blacklist_categories=["Cs"]), max_size=5), inner, max_size=3)
    ),
    max_leaves=10,
)
OBJECTS = st.dictionaries(st.sampled_from(["a", "b", "µ", ""]), VALUES)


@pytest.mark.parametrize(("content", "words"), REFUSED.values(), ids=REFUSED)
def test_what_coilcal_never_writes_is_one_sentence(content, words):
    for fault in (InvalidInput, CorruptStore):
        with pytest.raises(fault) as caught:
            json_of(content, "result.json", fault)
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 300


@pytest.mark.parametrize("content", ["[]", "1", "null", '"' + "x" * 5000 + '"'])
def test_another_value_than_an_object_is_refused(content):
    with pytest.raises(CorruptStore, match=r"result.json must hold a JSON object; it holds") as caught:
        json_object(content, "result.json", CorruptStore)
    assert len(str(caught.value)) < 200


def test_levels_up_to_the_limit_and_whole_characters_are_read():
    assert json_of("[" * 100 + "]" * 100, "a") is not None
    assert json_of('"\\ud83d\\ude00 \\\\ud800"', "a") == "😀 \\ud800"


@given(OBJECTS, st.sampled_from([None, 2]))
def test_a_sealed_object_is_read_back(content: dict[str, object], indent: int | None) -> None:
    text = sealed(content, indent)
    assert unsealed(json_object(text, "a"), "a") == content
    assert text.count("\n") == 1 or indent


@given(OBJECTS, st.data())
def test_no_altered_byte_is_taken_for_another_content(
    content: dict[str, object], data: st.DataObject
) -> None:
    text = bytearray(sealed(content).encode())
    text[data.draw(st.integers(0, len(text) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    try:
        read = unsealed(json_object(bytes(text), "a", CorruptStore), "a", CorruptStore)
    except CorruptStore:
        return
    assert read == content


def test_what_version_0_2_wrote_has_no_seal(tmp_path):
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps({"verdict": "named"}), encoding="utf-8")
    assert read_json(path) == {"verdict": "named"}
    path.write_text(sealed({"verdict": "named"}, indent=2).replace("named", "clean"), encoding="utf-8")
    with pytest.raises(CorruptStore, match=r"diagnosis.json must match its SHA-256; it was altered"):
        read_json(path, fault=CorruptStore)


def test_no_other_loader_reads_json():
    """But of text that the same process has just written or read by this loader, and between processes of one user (`--via local`)."""
    root = Path(__file__).parents[2] / "estimator"
    others = {
        path.relative_to(root).as_posix()
        for path in root.rglob("*.py")
        if re.search(r"\bjson\.loads?\(|model_validate_json\(", path.read_text(encoding="utf-8"))
    }
    via_local = {f"cli/{name}.py" for name in ("local", "local_server", "local_socket")}
    assert others == {"json_files.py", "service/tasks.py"} | via_local
