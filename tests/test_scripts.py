"""Scripts are not part of the package, so nothing else notices when a name they import is gone."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[1] / "scripts"
# JAX, an optional dependency of the one left out, changes how the process that imports it may fork.
NAMES = sorted({path.stem for path in SCRIPTS.glob("*.py")} - {"benchmark_nuts"})


@pytest.mark.parametrize("name", NAMES)
def test_script_finds_what_it_imports(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [str(SCRIPTS), *sys.path])
    runpy.run_path(str(SCRIPTS / f"{name}.py"), run_name="imported")
