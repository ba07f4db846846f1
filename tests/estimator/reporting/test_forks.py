"""Work in forks: the same results in the same order, and done here where a fork fails."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator

import pytest
from matplotlib.figure import Figure

from estimator import side_by_side
from estimator.reporting.forks import in_forks
from estimator.reporting.page import Picture, ReportPage, render_report

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="forks are safe on Linux alone")


@pytest.fixture(autouse=True)
def _two_cores(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(side_by_side, "MOST_CORES", 2)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    yield
    assert not multiprocessing.active_children()


def test_results_come_in_the_order_of_the_items_from_other_processes():
    results = in_forks(lambda n: (n, os.getpid()), range(7))
    assert [n for n, _ in results] == list(range(7))
    assert os.getpid() not in {pid for _, pid in results}
    assert len({pid for _, pid in results}) == 7


def test_a_result_larger_than_a_pipe_arrives():
    assert [len(text) for text in in_forks(lambda n: "x" * n, [3_000_000, 2_000_000])] == [
        3_000_000,
        2_000_000,
    ]


def test_what_is_killed_in_a_fork_is_done_here():
    here = os.getpid()

    def work(n: int) -> int:
        if n == 1 and os.getpid() != here:
            os.kill(os.getpid(), signal.SIGKILL)
        return 10 * n

    assert in_forks(work, [0, 1, 2]) == [0, 10, 20]


def test_a_fault_is_raised_here(capfd):
    with pytest.raises(ZeroDivisionError):
        in_forks(lambda n: 1 / n, [1, 0, 2])
    assert capfd.readouterr().err == ""


def test_ctrl_c_reaches_the_program_that_waits_and_not_its_forks():
    def work(n: int) -> int:
        os.kill(os.getpid(), signal.SIGINT)
        return n

    assert in_forks(work, [1, 2]) == [1, 2]


@pytest.mark.usefixtures("every_picture_is_drawn")
def test_a_page_drawn_in_forks_is_the_page_drawn_in_a_row(monkeypatch, tmp_path):
    """Each plot leaves a file that names its process."""

    def plot(n: int) -> Figure:
        (tmp_path / str(os.getpid())).touch()
        figure = Figure(figsize=(2.0, 1.0))
        figure.add_subplot().plot([0, n])
        return figure

    def page() -> ReportPage:
        pictures = [Picture(f"Picture {n}", "A line.", lambda n=n: plot(n)) for n in range(4)]
        return ReportPage("rig a", "2026-01-01", ["Fine."], lead=pictures[:1], figures=pictures[1:])

    forked = render_report(page())
    assert len(list(tmp_path.iterdir())) == 4
    assert not (tmp_path / str(os.getpid())).exists()
    monkeypatch.setattr(side_by_side, "MOST_CORES", 1)
    assert render_report(page()) == forked
    assert [forked.index(f"Picture {n}") for n in range(4)] == sorted(
        forked.index(f"Picture {n}") for n in range(4)
    )
