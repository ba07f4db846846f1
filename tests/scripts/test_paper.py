"""The studies of the paper run to their end."""

from __future__ import annotations

from pathlib import Path

import pytest

from scripts.paper import experiment_twin


@pytest.mark.slow
def test_the_twin_of_the_experiment_names_the_literal_sum_and_draws_it(tmp_path: Path) -> None:
    text = experiment_twin.study(tmp_path)
    assert "diagnose, not told: named\n- spherical_sum" in text
    assert {path.name for path in tmp_path.iterdir()} >= {"twin_residual.png", "twin_evidence.png"}
