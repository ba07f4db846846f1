"""The client against a service in a process of its own: the answers of the Python API, also while the service is killed."""

from __future__ import annotations

import inspect
import json
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from estimator import client as client_module
from estimator.calibration.calibrate import calibrate
from estimator.calibration.result import Calibration
from estimator.client import Client, JobFailed, RemoteCalibration, ServiceFault
from estimator.errors import InvalidInput
from estimator.inference.ensemble import SamplerSettings
from estimator.rig.rig import Rig
from estimator.store.session import Session
from tests.estimator.service.conftest import QUICK, Served, lines_of

SETTINGS = SamplerSettings(**QUICK)


def test_a_calibration_there_is_read_as_one_here(
    served: Callable[..., Served], small_session: Session, tmp_path: Path
) -> None:
    """The service is killed as soon as it has the job; the script does not notice."""
    service = served()
    port = int(service.url.rpartition(":")[2])
    restarted: list[Served] = []

    def kill() -> None:
        while not list((tmp_path / "data").glob("jobs/*/progress.jsonl")):
            time.sleep(0.01)
        service.kill()
        restarted.append(served("--port", port))

    killer = threading.Thread(target=kill)
    killer.start()
    told: list[Any] = []
    with Client(service.url) as client:
        there = client.calibrate(small_session, seed=2, settings=SETTINGS, on_progress=told.append)
        killer.join()
        here = calibrate(small_session, seed=2, settings=SETTINGS)
        assert there.summary() == json.loads(json.dumps(here.summary()))
        assert there.best == dict(here.best)
        assert there.rig == here.rig
        assert told[-1]["words"] == "page"
        points_m = torch.tensor([[0.0, 0.0, 0.01], [0.0, 0.049, -0.052]], dtype=torch.float64)
        for method in ("field", "gradient"):
            ours, theirs = (getattr(c, method)(points_m, {"coil1": 2.0}) for c in (here, there))
            assert torch.equal(ours.nan_to_num(7.0), theirs.nan_to_num(7.0)), method
        for method in ("field_interval", "gradient_interval"):
            ours, theirs = (
                torch.stack(getattr(c, method)(points_m, {"coil1": 2.0}, 0.5)) for c in (here, there)
            )
            assert torch.equal(ours.nan_to_num(7.0), theirs.nan_to_num(7.0)), method
        table = there.grid({"coil1": 2.0}, 0.5, x=(0.0, 0.02, 3), has_gradient=True)
        on_grid = torch.tensor([[x, 0.0, 0.0] for x in (0.0, 0.01, 0.02)], dtype=torch.float64)
        upper_T = here.field_interval(on_grid, {"coil1": 2.0}, 0.5)[1]
        assert table.column("Bz_upper_T").to_pylist() == upper_T[:, 2].tolist()
        gradient = here.gradient(on_grid, {"coil1": 2.0})
        assert table.column("dBy_dz_T_per_m").to_pylist() == gradient[:, 1, 2].tolist()
        assert client.calibration(there.id).summary() == there.summary()
        with pytest.raises(InvalidInput, match="coil9"):
            there.field(points_m, {"coil9": 1.0})
        first = client.upload(small_session)
        assert client.upload(small_session) == first
    restarted[0].end()


@pytest.mark.slow
def test_sessions_are_judged_designed_for_and_fitted_together_there(
    served: Callable[..., Served], small_session: Session, small_rig: Rig
) -> None:
    service = served()
    with Client(service.url) as client:
        entry = client.recalibrate(small_session, seed=2, settings=SETTINGS)
        assert (entry.conclusion, entry.version, entry.made) == ("updated", 1, 1)
        registry = client.registry(small_rig)
        assert registry.current == 1
        assert registry.calibration().summary()["session_hash"] == small_session.hash
        assert [version["version"] for version in registry.versions()] == [1]
        assert [item["session_id"] for item in registry.entries()] == [entry.session]
        with pytest.raises(InvalidInput, match="another than the one in use"):
            registry.roll_back(1)
        found = client.batch([small_session], hypotheses=["plain", "axis_gain"], has_posterior=False)
        assert [fit["hypothesis"] for fit in found["fits"]] == ["plain", "axis_gain"]
        plan = client.design(small_session, shrink="coil1.radius_m", n_readings=2)
        assert len(plan["reached"]) == 2
        assert len(list(client.pages("/v1/jobs", limit=1))) == 3


def test_readings_are_streamed_and_a_job_that_fails_says_why(
    served: Callable[..., Served], small_session: Session, small_rig: Rig
) -> None:
    service = served()
    readings = [json.loads(line) for line in lines_of(small_session, small_rig).splitlines()]
    with Client(service.url) as client:
        session = client.begin(small_rig, "a stream")
        assert [session.append(readings[:20]), session.append(readings[10:])] == [20, len(readings)]
        session.close()
        fixed = small_rig.with_fixed([p.name for p in small_rig.free if not p.is_count])
        with pytest.raises(JobFailed, match="must have a free parameter besides loop counts"):
            client.calibrate(small_session, fixed)


def test_a_service_that_is_not_there_is_said_in_words(
    monkeypatch: pytest.MonkeyPatch, small_session: Session
) -> None:
    monkeypatch.setattr(client_module, "FIRST_PAUSE_S", 0.001)
    with (
        Client("http://127.0.0.1:9") as client,
        pytest.raises(ServiceFault, match="service must answer; http://127.0.0.1:9"),
    ):
        client.calibrate(small_session)


@pytest.mark.parametrize("name", ["field", "gradient", "field_interval", "gradient_interval", "summary"])
def test_reading_methods_have_the_parameters_of_the_python_api(name: str) -> None:
    here, there = (inspect.signature(getattr(kind, name)) for kind in (Calibration, RemoteCalibration))
    assert list(here.parameters) == list(there.parameters)
