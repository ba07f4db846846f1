"""A diagnosis in a terminal and a notebook, and its figures one by one."""

from __future__ import annotations

from dataclasses import replace

import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.errors import InvalidInput

pytestmark = pytest.mark.whole


def test_a_diagnosis_is_shown_in_ten_lines_and_plots(diagnosis):
    lines = repr(diagnosis).splitlines()
    assert lines[0].startswith("Diagnosis of 'small', ")
    assert len(lines) <= 10
    assert any("µT" in line for line in lines[1:])
    html = diagnosis._repr_html_()
    assert html.count("<table>") == html.count("<img ") == 1
    assert isinstance(diagnosis.plot_residuals(), Axes)
    assert isinstance(diagnosis.plot_residuals(extended=False), Axes)
    assert isinstance(diagnosis.plot_budget(), Figure)
    without = replace(diagnosis, fits=replace(diagnosis.fits, budget=None))
    with pytest.raises(InvalidInput, match="a budget needs causes"):
        without.plot_budget()
    assert without._repr_html_().count("<img ") == 1
