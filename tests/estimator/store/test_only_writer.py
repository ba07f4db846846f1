"""A folder has one writer at a time, and none that leaves nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from estimator.errors import InvalidInput
from estimator.store.only_writer import only_writer


def test_a_second_writer_is_refused_until_the_first_has_ended(tmp_path: Path) -> None:
    folder = tmp_path / ".result.unfinished"
    with only_writer(folder):
        with (
            pytest.raises(
                InvalidInput,
                match=r"^output must be written by one program at a time; another writes .*/result$",
            ),
            only_writer(folder, tmp_path / "result"),
        ):
            pytest.fail("both write")
        (folder / "something").touch()
    with only_writer(folder):
        assert (folder / "something").exists()


def test_what_was_there_or_was_written_stays_and_an_empty_folder_does_not(tmp_path: Path) -> None:
    with only_writer(tmp_path / "in" / "new"):
        pass
    assert not (tmp_path / "in" / "new").exists()
    with pytest.raises(ValueError), only_writer(tmp_path / "refused"):  # noqa: PT011 - any error
        raise ValueError
    assert not (tmp_path / "refused").exists()
    (tmp_path / "old").mkdir()
    with only_writer(tmp_path / "old"):
        pass
    assert (tmp_path / "old").exists()


def test_a_folder_may_be_renamed_when_it_is_complete(tmp_path: Path) -> None:
    with only_writer(tmp_path / "new"):
        (tmp_path / "new").rename(tmp_path / "complete")
    assert [path.name for path in tmp_path.iterdir()] == ["complete"]


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with (
        pytest.raises(InvalidInput, match="must be a folder that can be written"),
        only_writer(tmp_path / "file" / "out"),
    ):
        pytest.fail("written")
