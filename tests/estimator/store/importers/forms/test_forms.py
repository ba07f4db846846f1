"""One table in many forms: each is read with the right values, or refused in one sentence whose cure works when it is followed."""

from __future__ import annotations

import re
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import torch
from click.testing import CliRunner, Result

from estimator.cli.main import main
from estimator.errors import InvalidInput
from estimator.rig_files.read import rig_from_text
from estimator.store.importers.forms.cells import plain_numbers
from estimator.store.importers.forms.layout import Line, layout_of
from estimator.store.importers.forms.understand import understood
from estimator.store.session import Session, load_session
from tests.estimator.store.importers.forms.forms import TEXTS, of_libraries
from tests.estimator.store.importers.forms.written import RIG, TABLE, Form

MOST_STEPS = 10  # sentences that one file may need


def imported(form: Form, folder: Path, content: bytes | str, name: str, options: list[str]) -> Result:
    (folder / "rig.yaml").write_text(form.rig, encoding="utf-8")
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    arguments = [
        "import",
        str(folder / name),
        "--rig",
        str(folder / "rig.yaml"),
        "--out",
        str(folder / "session.zarr"),
    ]
    n_threads = torch.get_num_threads()
    result = CliRunner().invoke(main, [*arguments, "--overwrite", "--yes", *options])
    torch.set_num_threads(n_threads)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


def refusal(result: Result) -> str:
    """The sentence of a refusal, which is the last line, and names the file."""
    sentence = result.stderr.strip().splitlines()[-1].removeprefix("coilcal: ")
    assert result.exit_code == 2
    return sentence


def followed(sentence: str, form: Form) -> list[str]:
    """The option that a sentence proposes; what only the user knows stands in the form. Empty where it asks for another file."""
    if match := re.search(r"(?:in series|of the sensor with) --column '([^']+)'", sentence):
        return ["--column", match[1]]
    if "HEADER" in sentence and (match := re.search(r"--constant (\w+)=(\w+)", sentence)):
        return ["--constant", f"{match[1]}={form.units.get(match[2], match[2])}"]
    if match := re.search(r"--column 'HEADER=Bx_(uT)'", sentence):
        return [part for axis in "xyz" for part in ("--column", f"B{axis}_T=B{axis}_{match[1]}")]
    if match := re.search(r"--column '([^']+)=(\w+)_UNIT'", sentence):
        header, quantity = match[1], match[2]
        if header == "HEADER":  # the user knows the column
            header, quantity = "B (uT)", "Bz"
        return ["--column", f"{header}={quantity}_{form.units.get(quantity, 'uT')}"]
    if match := re.search(r"(--skip-bad-lines|--clock \w+|--decimal \w+)", sentence):
        return match[1].split()
    if match := re.search(r"--constant (\w+)=(\w+)", sentence):
        return ["--constant", f"{match[1]}={form.units.get(match[2], match[2])}"]
    if match := re.search(r"--column '([^']+)=-'", sentence):
        names = [name for name in re.findall(r"'([^']+)'", sentence) if form.units.get("-", "?") in name]
        return ["--column", f"{names[0] if names else match[1]}=-"]
    return []


def session_of(form: Form, folder: Path) -> tuple[Session, Result, str]:
    """What comes of a form when sentences are followed, what was told last, and the first refusal."""
    content, name, options, first = form.content, form.name, list[str](), ""
    for _ in range(MOST_STEPS):
        result = imported(form, folder, content, name, options)
        if result.exit_code == 0:
            return load_session(folder / "session.zarr"), result, first
        sentence = refusal(result)
        assert name in sentence
        assert "\n" not in sentence
        first = first or sentence
        step = followed(sentence, form)
        if step:
            assert tuple(step) not in pairwise(options), sentence
            options += step
        else:
            assert form.answer is not None, sentence
            content, name = form.answer, "again.csv"
    raise AssertionError(sentence)


def check(form: Form, folder: Path) -> None:
    session, result, first = session_of(form, folder)
    o = session.observations
    assert bool(first) is not form.is_read, first or "read at once"
    told = f"{first}\n{result.stdout}\n{result.stderr}"
    assert form.tells in told
    rows = np.column_stack(
        (o.time_s.numpy(), o.current_A[:, 0], 1e3 * o.motion["stage"][:, :3], 1e6 * o.field_sensor_T)
    )
    np.testing.assert_allclose(
        rows, form.expected, rtol=1e-5, atol=0.051 if "thousands" in form.name else 1e-6
    )
    assert not o.motion["stage"][:, 3:].any()


@pytest.mark.parametrize("form", TEXTS, ids=lambda form: form.name)
def test_a_text_is_read_or_refused_with_a_cure_that_works(form, tmp_path):
    check(form, tmp_path)


def test_files_of_libraries_are_read_or_refused_with_a_cure_that_works(tmp_path):
    for form in of_libraries(tmp_path):
        check(form, tmp_path)


def test_three_decimals_after_a_zero_are_no_thousands():
    rows = ["z [mm];B [mT]", "-200;0,448", "-190;0,504", "-180;1,047"]
    layout = layout_of([Line(i, row) for i, row in enumerate(rows, 1)])
    assert layout is not None
    assert (layout.decimal, layout.is_unclear) == (",", False)
    assert plain_numbers(layout.decimal)(["0,448", "1,047"]) == ["0.448", "1.047"]


def test_there_are_sixty_forms(tmp_path):
    assert len(TEXTS) + len(of_libraries(tmp_path)) >= 60
    assert len({form.name for form in TEXTS}) == len(TEXTS)
    assert sum(form.name.startswith("real_") for form in TEXTS) >= 10
    assert len(TABLE) == 60


@pytest.mark.parametrize(
    "content", [";".join(["9"] * 100_000), "t [s];" + "x" * 3_000_000, "[" * 300_000, "1,2;" * 500_000]
)
def test_endless_lines_are_refused_at_once(content, tmp_path):
    (tmp_path / "a.csv").write_text(f"{content}\n{content}\n", encoding="utf-8")
    begin_s = time.process_time()
    with pytest.raises(InvalidInput, match="a.csv"):
        understood(tmp_path / "a.csv", rig_from_text(RIG))
    assert time.process_time() - begin_s < 10.0
