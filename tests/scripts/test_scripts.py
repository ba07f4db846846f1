"""Scripts are not part of the package, so nothing else notices when a name they use is gone."""

from __future__ import annotations

import importlib
import runpy
import sys
from functools import partial
from pathlib import Path

import pytest

import estimator
from tests.estimator.conftest import SETTINGS

SCRIPTS = Path(__file__).parents[2] / "scripts"
# JAX, an optional dependency of the one left out, changes how the process that imports it may fork.
NAMES = sorted(
    ".".join(path.relative_to(SCRIPTS.parent).with_suffix("").parts) for path in SCRIPTS.rglob("*.py")
)
NAMES.remove("scripts.benchmarks.nuts")


def test_scripts_find_what_they_import():
    for name in NAMES:
        importlib.import_module(name)


def run(name: str, *arguments: str) -> None:
    """As from the command line."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(sys, "argv", [name, *arguments])
        patched.delitem(
            sys.modules, f"scripts.{name}", raising=False
        )  # runpy warns of a module imported before
        runpy.run_module(f"scripts.{name}", run_name="__main__")


@pytest.mark.whole
def test_recalibrate_judges_what_lies_in_the_inbox(small_session, rig_text, tmp_path, monkeypatch, capsys):
    (tmp_path / "rig.yaml").write_text(rig_text, encoding="utf-8")
    small_session.save(tmp_path / "inbox" / "first.zarr")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(estimator, "recalibrate", partial(estimator.recalibrate, settings=SETTINGS))
    run("recalibrate")
    said = capsys.readouterr().out
    assert "first.zarr: updated, first calibration" in said
    assert "coil1.radius_m" in said
    assert "version 1 is in use" in said
