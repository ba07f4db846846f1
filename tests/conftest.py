"""Settings of every test run: no screen, one thread per worker, and the same examples each time."""

from __future__ import annotations

import gc
import logging
import os
import signal
import sys
import tempfile
import threading
from pathlib import Path

import matplotlib as mpl
import pytest
import torch
from hypothesis import settings

from tests.program import programs_end

mpl.use("Agg")

# Sessions are many small files, and each is waited for until it is on disk: in memory they take half the time. Programs are compiled and
# run there too. Whoever sets TMPDIR decides.
MEMORY, NEEDED_BYTES = Path("/dev/shm"), 2 * 2**30
if "TMPDIR" not in os.environ and os.access(MEMORY, os.W_OK | os.X_OK):
    there = os.statvfs(MEMORY)
    if there.f_bavail * there.f_frsize > NEEDED_BYTES and not there.f_flag & os.ST_NOEXEC:
        os.environ["TMPDIR"], tempfile.tempdir = str(MEMORY), None

# What is imported and collected stays: garbage is not looked for in it, neither now nor while tests run (`pytest_collection_finish`).
gc.disable()


class _Raising(logging.Handler):
    """Raises what is logged."""

    def emit(self, record: logging.LogRecord) -> None:
        raise AssertionError(record.getMessage())


# No part of a report is left out unseen; a test that wants one to be takes the handler away.
logging.getLogger("estimator.diagnosis.part_by_part").addHandler(_Raising(logging.ERROR))

# Workers of pytest-xdist, and whatever else runs, share the cores: threads of torch on top only wait for each other.
torch.set_num_threads(1)

# The first example of a test imports and compiles, so a deadline per example measures the machine.
settings.register_profile("coilcal", deadline=None, derandomize=True)
settings.load_profile("coilcal")

# A shell starts what runs in the background deaf to Ctrl-C, and so would be the programs that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGALRM)

# Where simulated instruments, watchdogs and clusters run in processes of their own, a busy computer can miss a deadline.
HERE = Path(__file__).parent
REAL_TIME = {
    *(HERE / f"contract/test_{name}.py" for name in ("arms", "drivers", "replays")),
    HERE / "drivers",
    *(
        HERE / f"estimator/cli/test_{name}.py"
        for name in (
            "acquire",
            "acquire_faults",
            "acquire_general",
            "acquire_warm",
            "devices",
            "live",
            "rig_simulator",
        )
    ),
    HERE / "estimator/batching/test_engine.py",
    HERE / "estimator/live/test_refresh.py",
}

# Whole fits, chains and diagnoses, and laws that fields are held to at many points: a check of the shapes in every call makes them take
# two to three times as long. The writer of rigs is among them, since beartype draws at random what it checks, and Hypothesis refuses
# that inside a strategy.
WHOLE = {
    *(HERE / name for name in ("hidden", "physics")),
    *(HERE / f"estimator/{name}" for name in ("batching", "cli", "live", "recalibration", "service")),
    *(
        HERE / f"estimator/{name}.py"
        for name in (
            "calibration/test_calibrate",
            "calibration/test_predictions",
            "diagnosis/hypotheses/test_several_places",
            "diagnosis/hypotheses/test_search",
            "diagnosis/next_readings/test_design",
            "diagnosis/structure/test_cross_validation",
            "diagnosis/mixture/test_expansion",
            "diagnosis/test_evidence",
            "diagnosis/test_posterior",
            "diagnosis/test_report",
            "diagnosis/test_geometry_of_mistakes",
            "diagnosis/test_stated",
            "diagnosis/test_verdict",
            "diagnosis/test_widening",
            "field/test_harmonics",
            "inference/test_collapsed",
            "inference/test_ensemble",
            "inference/test_lattice",
            "inference/test_point_estimate",
            "model/test_one_model",
            "model/test_unit_gate",
            "rig_files/test_write",
            "store/importers/forms/test_forms",
            "system/test_superposition",
        )
    ),
}


@pytest.fixture(autouse=True)
def _signals_and_hooks_as_before():
    """A command that a test runs in its own process takes Ctrl-C for itself until the program ends, which this one does not."""
    hook, handlers = sys.unraisablehook, {number: signal.getsignal(number) for number in SIGNALS}
    yield
    sys.unraisablehook = hook
    if threading.current_thread() is threading.main_thread():
        for number, handler in handlers.items():
            signal.signal(number, handler)


@pytest.fixture(autouse=True)
def _programs_end():
    with programs_end():
        yield


@pytest.fixture(scope="session", autouse=True)
def _one_core_for_a_diagnosis():
    """As for torch. Not at the top, for what is imported there is not checked for shapes."""
    from estimator import side_by_side

    before, side_by_side.MOST_CORES = side_by_side.MOST_CORES, 1
    yield
    side_by_side.MOST_CORES = before


@pytest.fixture(scope="session", autouse=True)
def _each_kind_of_picture_is_drawn_once():
    """Drawing takes four fifths of the time of a calibration of a small rig: a worker draws the first picture of each title and size."""
    from estimator.reporting.page import Picture

    drawn: dict[tuple[str, float, float], str] = {}
    draw = Picture.png_base64

    def remembered(picture: Picture) -> str:
        kind = (picture.title, *picture.figure.get_size_inches())
        if kind not in drawn:
            drawn[kind] = draw.fget(picture)
        return drawn[kind]

    Picture.png_base64 = property(remembered, doc=draw.__doc__)
    yield draw
    Picture.png_base64 = draw


@pytest.fixture
def every_picture_is_drawn(_each_kind_of_picture_is_drawn_once: property, monkeypatch: pytest.MonkeyPatch):
    """For tests that look at pictures, or compare pages with theirs."""
    from estimator.reporting.page import Picture

    monkeypatch.setattr(Picture, "png_base64", _each_kind_of_picture_is_drawn_once)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Each half of `make test` leaves out files that have nothing for it, for importing all takes every worker half a minute."""
    chosen = config.option.markexpr
    if "whole" not in chosen or collection_path.name == "conftest.py":
        return None
    is_whole = not WHOLE.isdisjoint((collection_path, *collection_path.parents))
    if "not whole" in chosen:
        return is_whole or None
    is_file = collection_path.suffix == ".py"
    return (
        is_file and not is_whole and "mark.whole" not in collection_path.read_text(encoding="utf-8")
    ) or None


def pytest_collection_finish() -> None:
    """See `gc.disable` above."""
    gc.collect()
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests against real time fail where they fail three times; `make test` runs whole fits without checks of shapes."""
    for item in items:
        above = (item.path, *item.path.parents)
        if not REAL_TIME.isdisjoint(above):
            item.add_marker(pytest.mark.flaky(reruns=2, reruns_delay=2))
        if not WHOLE.isdisjoint(above):
            item.add_marker(pytest.mark.whole)
