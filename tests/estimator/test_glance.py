"""Representations of at most ten lines, in notebooks with a table and a figure; figures one by one; a first rig and a data frame."""

from __future__ import annotations

from html.parser import HTMLParser
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimator.errors import InvalidInput
from estimator.glance import Shown
from estimator.rig.rig import Rig
from estimator.rig_files.read import load_rig, rig_from_text
from estimator.rig_files.starter import Moved, Starter, starter_rig_text
from estimator.store.session import Session


class Tags(HTMLParser):
    """Counts what is opened and closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.opened: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.opened.append(tag)
        if tag != "img":
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in self.open:
            while self.open.pop() != tag:
                raise AssertionError(tag)


def check(shown: Shown, *words: str) -> None:
    text = repr(shown)
    lines = text.splitlines()
    assert len(lines) <= 10
    assert max(map(len, lines)) <= 118
    assert all(word in text for word in words)
    tags = Tags(shown._repr_html_())
    assert not tags.open
    assert {"p", "table"} <= set(tags.opened)
    assert {"svg", "img"} & set(tags.opened)


def test_a_rig_is_shown_in_ten_lines(small_rig):
    check(small_rig, "Rig 'small': coil coil1", "coil1.radius_m", "51 ± 1 mm")
    check(load_rig("configs/paper_simulation.yaml"), "Rig")


def test_a_session_is_shown_in_ten_lines(small_session):
    check(small_session, "36 readings (9 of them for validation)", "coil1 current", "3 A")


def test_a_calibration_is_shown_in_ten_lines_and_plots(small_calibration):
    check(small_calibration, "µT rms on unseen readings", "median ± sd", "mm")
    assert isinstance(small_calibration.plot_field(), Figure)
    assert isinstance(small_calibration.plot_residuals(), Axes)
    assert isinstance(small_calibration.plot_parameters(), Axes)
    with pytest.raises(InvalidInput, match="coil must be one of coil1; received 'coil9'"):
        small_calibration.plot_field("coil9")


@pytest.mark.parametrize("moves", ["sensor", "coil"])
def test_a_first_rig_is_the_one_that_init_writes(moves):
    rig = Rig.coil(
        0.048, 45, 22, wire_radius_m=0.46e-3, distance_m=0.04, noise_T=20e-6, moves=moves, name="bench"
    )
    text = starter_rig_text(Starter(name="bench", moved=Moved(moves)))
    written = rig_from_text(text.replace("arm1", "stage"))
    assert list(rig.parameters) == list(written.parameters)
    for name, parameter in written.parameters.items():
        own = rig.parameters[name]
        assert (own.unit, own.is_positive, own.is_count, own.tie) == (
            parameter.unit,
            parameter.is_positive,
            parameter.is_count,
            parameter.tie,
        )
        assert own.value == pytest.approx(parameter.value, rel=1e-9)
        assert (own.prior is None) is (parameter.prior is None)
        if own.prior is not None and parameter.prior is not None:
            assert type(own.prior) is type(parameter.prior)
            assert own.prior.sd == pytest.approx(parameter.prior.sd, rel=1e-2)
            assert (own.prior.lower, own.prior.upper) == (parameter.prior.lower, parameter.prior.upper)
    assert (rig.coils, rig.sensors, rig.movers, rig.effects) == (
        written.coils,
        written.sensors,
        written.movers,
        written.effects,
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"radius_m": -1.0}, "radius_m must be > 0; received -1"),
        ({"axial_loops": 1e9}, "axial_loops must be at most 5000"),
        ({"moves": "both"}, "moves must be 'coil' or 'sensor'"),
        ({"noise_T": 0.0}, "noise_T must be > 0"),
        ({"radius_m": 0.004}, "radius_m must exceed"),
    ],
)
def test_an_impossible_first_rig_is_refused(change, words):
    arguments = {"radius_m": 0.05, "axial_loops": 30, "radial_loops": 12, "wire_radius_m": 4e-4, **change}
    with pytest.raises(InvalidInput, match=words):
        Rig.coil(**arguments)


@pytest.fixture
def frame(small_session: Session) -> pd.DataFrame:
    """The small session with headings and units of a laboratory."""
    o = small_session.observations
    columns = {"Time": o.time_s, "I coil1 (A)": o.current_A[:, 0]}
    columns |= {f"arm1_{axis}_mm": 1e3 * o.motion["arm1"][:, i] for i, axis in enumerate("xyz")}
    columns |= {f"B{axis} [mT]": 1e3 * o.field_sensor_T[:, i] for i, axis in enumerate("xyz")}
    return pd.DataFrame({name: values.numpy() for name, values in columns.items()} | {"remark": "ok"})


def test_a_data_frame_is_read_as_a_file_is(frame, small_session):
    columns = {"Time": "t_s", "I coil1 (A)": "coil1_current_A"}
    session = Session.from_dataframe(frame, small_session.rig, columns=columns, source="monday")
    expected, read = small_session.observations, session.observations
    for name in ("time_s", "current_A", "field_sensor_T"):
        torch.testing.assert_close(getattr(read, name), getattr(expected, name), rtol=1e-12, atol=1e-15)
    assert (session.source, read.line, int(read.is_validation.sum()) > 0) == ("monday", None, True)
    as_mapping = Session.from_dataframe(dict(frame.items()), small_session.rig, columns=columns)
    assert as_mapping.hash == session.hash


def test_refusals_of_a_data_frame_name_arguments(frame, small_session):
    rig = small_session.rig
    for broken, words in (
        (
            frame.drop(columns=["I coil1 (A)", "Time"]),
            "or give it for all rows, such as constants={'coil1_current_A': AMPERE}",
        ),
        (frame.rename(columns={"Time": "t_s", "By [mT]": "By"}), "or say it with columns={'By': 'By_UNIT'}"),
    ):
        with pytest.raises(InvalidInput) as refusal:
            Session.from_dataframe(broken, rig)
        assert words in str(refusal.value)
        assert "--" not in str(refusal.value)
    with pytest.raises(InvalidInput, match="frame must be a data frame, or a mapping of columns"):
        Session.from_dataframe(np.zeros((3, 3)), rig)
    with pytest.raises(InvalidInput, match="must be equally long"):
        Session.from_dataframe({"Bx_T": [1.0], "By_T": [1.0, 2.0]}, rig)
