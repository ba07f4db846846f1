"""Every study of the list can be run: by `make study`, by its own target, with modules and files that exist."""

from __future__ import annotations

import importlib.util
import re
import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAIN = runpy.run_path(str(ROOT / "scripts/studies/__main__.py"), run_name="studies")


def test_makefile_has_a_target_for_each_study():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    listed = re.search(r"^STUDIES := (.*)$", makefile, re.MULTILINE)
    assert listed is not None
    assert set(listed[1].split()) == set(MAIN["studies"]())


def test_calls_name_what_exists():
    for name in MAIN["studies"]():
        for module, *arguments in MAIN["calls"](MAIN["studies"]()[name]):
            assert importlib.util.find_spec(module) is not None, module
            for path in arguments:
                assert not path.startswith("tests/") or (ROOT / path).exists(), path


def test_unknown_study_is_refused(capsys):
    with pytest.raises(SystemExit, match="hiden"):
        MAIN["main"](["hiden"])
    assert "hidden " in capsys.readouterr().out


def test_calls_run_with_this_python(monkeypatch):
    made: list[list[str]] = []
    monkeypatch.setattr("subprocess.run", lambda call, **_: made.append(call))
    MAIN["main"](["service-storm"])
    assert [call[:3] for call in made] == [
        [sys.executable, "-m", "scripts.studies.service_storm"],
        [sys.executable, "-m", "scripts.studies.service_job_storm"],
    ]
