"""Predictions over HTTP: the numbers of the Python API, at points and on grids, as JSON and as Arrow; together in one batch; a bounded queue."""

from __future__ import annotations

import asyncio
import io
import json
import threading
import zipfile
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest
import torch
from starlette.testclient import TestClient

from estimator.calibration.predictions import Question, Wanted
from estimator.calibration.result import Calibration
from estimator.client import Client, RemoteCalibration
from estimator.diagnosis.posterior import doubted
from estimator.errors import InvalidInput
from estimator.export.formats import default_path
from estimator.export.request import Grid
from estimator.service import predictions as module
from estimator.service.core import Core
from estimator.service.predictions import Predictor
from estimator.service.problems import Problem
from estimator.service.schema import CalibrationRow, Job, SessionRow
from estimator.service.tasks import CALIBRATION
from tests.estimator.conftest import CORED_SIZES, SIDEWAYS
from tests.estimator.service.conftest import import_csv, refusal, upload_rig

POINTS_M = [[0.0, 0.0, 0.01], [0.01, -0.02, 0.0], [0.0, 0.049, -0.052]]  # the last one lies in the winding
CURRENTS_A = {"coil1": 2.0}
MOTION = [0.0, 0.0, 0.004, 0.0, 0.0, 0.1]


@pytest.fixture
def client(
    idle: Callable[..., TestClient], small_calibration: Calibration, rig_text: str, readings_csv: bytes
) -> TestClient:
    """A service that has a calibration, without a job having made it."""
    client = idle(most_predictions=3, most_grid_points=1000)
    keep(client, small_calibration, rig_text, readings_csv)
    return client


def keep(client: TestClient, calibration: Calibration, rig_text: str, readings_csv: bytes) -> None:
    """Give a service a calibration."""
    session_id = str(import_csv(client, upload_rig(client, rig_text), readings_csv)["id"])
    core: Core = client.app.state.core
    calibration.save(core.jobs.folder(ID) / CALIBRATION)
    times = {"created": "2026-01-01", "started": "2026-01-01", "ended": "2026-01-01"}
    with core.database.writing() as db:
        made = {"id": ID, "user": "local", "kind": "calibrate", "state": "done", "session_id": session_id}
        db.add(Job(**made, **times, options={}, starts=1))
        db.flush()
        made = {"id": ID, "job_id": ID, "session_id": session_id, "rig_name": "small", "user": "local"}
        db.add(CalibrationRow(**made, created="2026-01-01"))
        assert db.get(SessionRow, session_id)


ID = "c" * 32
PATH = f"/v1/calibrations/{ID}"


def test_a_prediction_has_the_numbers_of_the_python_api(client, small_calibration):
    body = {"points_m": POINTS_M, "currents_A": CURRENTS_A, "level": 0.8, "has_gradient": True}
    received = client.post(f"{PATH}/predict", json=body).json()
    points_m = torch.tensor(POINTS_M, dtype=torch.float64)
    expected = {
        "field_T": small_calibration.field(points_m, CURRENTS_A),
        "gradient_T_per_m": small_calibration.gradient(points_m, CURRENTS_A),
    }
    ends = small_calibration.field_interval(points_m, CURRENTS_A, 0.8)
    expected["field_lower_T"], expected["field_upper_T"] = ends
    ends = small_calibration.gradient_interval(points_m, CURRENTS_A, 0.8)
    expected["gradient_lower_T_per_m"], expected["gradient_upper_T_per_m"] = ends
    assert received.keys() == expected.keys()
    for name, tensor in expected.items():
        assert torch.equal(torch.tensor(received[name][:2], dtype=torch.float64), tensor[:2]), name
        assert set(np.array(received[name][2], dtype=object).ravel()) == {None}
    table = arrow(client.post(f"{PATH}/predict.arrow", json=body))
    assert table.column("dBx_dz_upper_T_per_m")[1].as_py() == received["gradient_upper_T_per_m"][1][0][2]
    assert table.column("By_lower_T").to_pylist() == [row[1] for row in received["field_lower_T"]]
    plain = client.post(f"{PATH}/predict", json={**body, "has_gradient": False, "has_intervals": False})
    assert plain.json() == {"field_T": received["field_T"]}


@pytest.mark.whole
def test_a_calibration_that_is_not_good_says_so_beside_its_predictions(
    idle, small_calibration, rig_text, readings_csv
):
    asked = {"points_m": POINTS_M, "currents_A": CURRENTS_A}
    suspect = idle()
    keep(suspect, doubted(small_calibration, ["a plate stands beside it."]), rig_text, readings_csv)
    caution = "suspect: a plate stands beside it. Intervals hold only if nothing is wrong."
    assert suspect.post(f"{PATH}/predict", json=asked).json()["caution"] == caution
    told = pa.ipc.open_stream(suspect.post(f"{PATH}/predict.arrow", json=asked).content).schema.metadata
    assert told[b"caution"].decode() == caution
    there = RemoteCalibration(ID, suspect.get(f"{PATH}/summary").json(), through(suspect).connection)
    at_m = torch.tensor(POINTS_M[:2], dtype=torch.float64)
    assert torch.equal(there.field(at_m, CURRENTS_A), small_calibration.field(at_m, CURRENTS_A))


def through(client: TestClient) -> Client:
    """A client of an application in this process."""

    def answer(request: httpx.Request) -> httpx.Response:
        content, headers = request.content, dict(request.headers) | {"host": "127.0.0.1:8765"}
        answered = client.request(
            request.method, request.url.raw_path.decode(), content=content, headers=headers
        )
        return httpx.Response(answered.status_code, content=answered.content)

    return Client("http://127.0.0.1:8765", transport=httpx.MockTransport(answer))


def test_a_correction_and_an_iron_core_are_in_predictions(idle, cored_calibration, rig_text, readings_csv):
    client, points_m = idle(), POINTS_M[:2]
    keep(client, cored_calibration, rig_text, readings_csv)
    received = client.post(
        f"{PATH}/predict", json={"points_m": points_m, "currents_A": CURRENTS_A, "level": 0.9}
    )
    at_m = torch.tensor(points_m, dtype=torch.float64)
    lower_T, upper_T = cored_calibration.field_interval(at_m, CURRENTS_A, 0.9)
    expected = {
        "field_T": cored_calibration.field(at_m, CURRENTS_A),
        "field_lower_T": lower_T,
        "field_upper_T": upper_T,
    }
    for name, field_T in expected.items():
        assert torch.equal(torch.tensor(received.json()[name], dtype=torch.float64), field_T), name
    # On its axis only the correction, 15 uT/A, has a field across the coil.
    across_T = expected["field_T"][0, :2].norm() / CURRENTS_A["coil1"]
    assert float(across_T) == pytest.approx(CORED_SIZES[SIDEWAYS], rel=0.5)


def arrow(answer: Any) -> pa.Table:
    assert answer.headers["content-type"] == "application/vnd.apache.arrow.stream"
    return pa.ipc.open_stream(answer.content).read_all()


def test_two_calibrations_are_compared_as_numbers_and_as_a_page(client):
    """Here one with itself: the fields are the same, and both have the same readings."""
    told = client.get(f"{PATH}/compare/{ID}").json()
    (field,) = told["fields"]
    assert (field["rms_T_per_A"], told["is_same_session"]) == (0.0, True)
    assert told["sentences"][1] == "No number differs by more than 3 standard deviations."
    page = client.get(f"{PATH}/compare/{ID}/report")
    assert "Difference of the fields of coil1" in page.text
    assert "sandbox" in page.headers["content-security-policy"]
    again = client.get(f"{PATH}/compare/{ID}/report", headers={"If-None-Match": page.headers["etag"]})
    assert again.status_code == 304
    assert client.get(f"{PATH}/compare/{'d' * 32}").status_code == 404


def test_a_grid_has_its_points_in_the_order_of_its_axes(client, monkeypatch):
    monkeypatch.setattr("estimator.service.routes.predictions.BLOCK", 4)  # 12 points in three blocks
    grid = {"x": {"first_m": -0.01, "last_m": 0.01, "n": 3}, "z": {"first_m": 0.0, "last_m": 0.03, "n": 4}}
    body = {**grid, "currents_A": CURRENTS_A}
    received = client.post(f"{PATH}/grid", json=body).json()
    assert received["x_m"] == [-0.01, 0.0, 0.01]
    assert received["y_m"] == [0.0]
    points_m = [[x, y, z] for x in received["x_m"] for y in received["y_m"] for z in received["z_m"]]
    at_points = client.post(f"{PATH}/predict", json={"points_m": points_m, "currents_A": CURRENTS_A}).json()
    assert {name: received[name] for name in at_points} == at_points
    streamed = client.post(f"{PATH}/grid.arrow", json=body)
    table = arrow(streamed)
    assert len(pa.ipc.open_stream(streamed.content).read_all().to_batches()) == 3
    assert [
        list(row) for row in zip(*(table.column(f"{a}_m").to_pylist() for a in "xyz"), strict=True)
    ] == points_m
    assert table.column("Bz_upper_T").to_pylist() == [row[2] for row in received["field_upper_T"]]
    assert table.schema.metadata[b"calibration_id"].decode() == ID


def test_what_the_rig_has_not_or_the_limits_forbid_is_refused(client):
    one = {"points_m": [[0, 0, 0]]}
    for path in (f"{PATH}/predict", f"{PATH}/predict.arrow"):
        answer = client.post(path, json={**one, "currents_A": {"coil7": 1}})
        assert refusal(answer, 422)["value"] == "'coil7'"
        body = {**one, "currents_A": CURRENTS_A, "motion": {"arm9": [0] * 6}}
        assert refusal(client.post(path, json=body), 422)["value"] == "arm9"
    text = b'{"points_m": [[0, 0, NaN]], "currents_A": {}}'
    refusal(client.post(f"{PATH}/predict", content=text, headers={"Content-Type": "application/json"}), 422)
    body = {"points_m": [[0, 0, 0]] * 20_001, "currents_A": {}}
    assert refusal(client.post(f"{PATH}/predict", json=body), 413)["value"] == "20001"
    axis = {"first_m": 0.0, "last_m": 0.1, "n": 11}
    body = {"x": axis, "y": axis, "z": axis, "currents_A": {}}
    assert refusal(client.post(f"{PATH}/grid.arrow", json=body), 413)["value"] == "1331"
    refusal(client.post(f"/v1/calibrations/{'d' * 32}/grid", json={"currents_A": {}}), 404)


def test_a_calibration_is_downloaded_as_it_lies_on_disk(client, small_calibration, tmp_path):
    """Its report stays behind; what is read again is sealed by its hashes."""
    core: Core = client.app.state.core
    (core.jobs.folder(ID) / CALIBRATION / "report.html").write_text("page", encoding="utf-8")
    answer = client.get(f"{PATH}/calibration.zip")
    assert answer.headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        assert {name.split("/")[0] for name in archive.namelist()} == {"posterior.zarr", "summary.json"}
        archive.extractall(tmp_path / "there")
    there = Calibration.load(tmp_path / "there")
    assert there.best == small_calibration.best
    for name in ("calibration.zip", "rig", "intervals", "summary"):
        tag = client.get(f"{PATH}/{name}").headers["etag"]
        again = client.get(f"{PATH}/{name}", headers={"If-None-Match": tag})
        assert (again.status_code, again.content) == (304, b""), name


# The queue


@pytest.fixture
def slow(small_calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """A predictor whose first batch waits for `go`, and what it was asked."""
    told: dict[str, Any] = {"go": threading.Event(), "begun": threading.Event(), "sizes": []}
    answer = module.answers

    def counted(calibration: Calibration, questions: list[Question], wanted: Wanted) -> Any:
        told["sizes"].append(len(questions))
        told["begun"].set()
        told["go"].wait(30)
        return answer(calibration, questions, wanted)

    monkeypatch.setattr(module, "answers", counted)
    told["predictor"] = Predictor(lambda _: small_calibration, most_waiting=2)
    yield told
    told["go"].set()
    told["predictor"].close()


def ask(predictor: Predictor, coil: str = "coil1") -> Any:
    question = Question(torch.tensor(POINTS_M[:1], dtype=torch.float64), {coil: 2.0}, {})
    return asyncio.run(predictor.ask(Path("any"), question, Wanted(has_intervals=False)))


def test_what_arrives_together_runs_as_one_batch_and_a_fault_stays_with_its_own(slow, small_calibration):
    with ThreadPoolExecutor(6) as pool:
        first = pool.submit(ask, slow["predictor"])
        slow["begun"].wait(30)
        others = [pool.submit(ask, slow["predictor"]) for _ in range(3)]
        wrong = pool.submit(ask, slow["predictor"], "coil9")
        while slow["predictor"]._queue.qsize() < 4:
            pass
        slow["go"].set()
        expected = small_calibration.field(torch.tensor(POINTS_M[:1], dtype=torch.float64), CURRENTS_A)
        for answer in (first, *others):
            torch.testing.assert_close(answer.result()["field_T"], expected, rtol=1e-12, atol=0.0)
        with pytest.raises(InvalidInput, match="coil9"):
            wrong.result()
    assert slow["sizes"] == [1, 4, 1, 1, 1, 1]


def test_a_full_queue_says_when_to_come_again(slow, client):
    slow["go"].set()
    small: Predictor = slow["predictor"]
    with (
        small.limit.taken(),
        small.limit.taken(),
        pytest.raises(Problem, match="at most 2 at once"),
        small.limit.taken(),
    ):
        pass
    predictor: Predictor = client.app.state.core.predictor
    body = json.dumps({"points_m": POINTS_M, "currents_A": CURRENTS_A})
    call = {"content": body, "headers": {"Content-Type": "application/json"}}
    with predictor.limit.taken(), predictor.limit.taken(), predictor.limit.taken():
        answer = client.post(f"{PATH}/predict", **call)
        assert refusal(answer, 429)["thing"] == "predictions"
        assert int(answer.headers["retry-after"]) > 0
    for path in ("predict", "predict.arrow"):  # every place is given back
        for _ in range(4):
            assert client.post(f"{PATH}/{path}", **call).status_code == 200


def test_an_export_is_the_file_of_the_python_api(client, small_calibration, tmp_path):
    axes_m = {"x_m": [-0.01, 0.01], "y_m": [0.0], "z_m": [0.0, 0.02, 0.03]}
    grid = Grid(*(np.array(coordinates_m) for coordinates_m in axes_m.values()))
    asked: dict[str, dict[str, Any]] = {"json": {}, "cpp": {}, "urdf": {}}
    asked["csv"] = asked["vtk"] = {"grid": axes_m, "currents_A": CURRENTS_A, "motion": {"arm1": MOTION}}
    motion = {"arm1": torch.tensor(MOTION, dtype=torch.float64)}
    for to, body in asked.items():
        received = client.post(f"{PATH}/export", json={"to": to, **body})
        here: dict[str, Any] = {"grid": grid, "currents_A": CURRENTS_A, "motion": motion} if body else {}
        written = small_calibration.export(
            to, tmp_path / default_path(small_calibration.magnet(), to), **here
        )
        assert received.content == written.read_bytes()
        assert f'filename="{written.name}"' in received.headers["content-disposition"]
    assert [path.name for path in client.app.state.core.uploads.iterdir()] == []


def test_an_export_that_cannot_be_is_refused(client):
    def refused(code: int, **body: Any) -> dict[str, Any]:
        return refusal(client.post(f"{PATH}/export", json=body), code)

    axes_m = {"x_m": [0.0], "y_m": [0.0], "z_m": [0.0]}
    assert "must be one of json" in refused(422, to="../../x")["detail"]
    assert "must have no grid" in refused(422, to="json", grid=axes_m)["detail"]
    assert "must have a grid" in refused(422, to="csv", currents_A=CURRENTS_A)["detail"]
    assert "must ascend" in refused(422, to="csv", grid={**axes_m, "y_m": [1.0, 0.0]})["detail"]
    assert "must name movers" in refused(422, to="vtk", grid=axes_m, motion={"nobody": MOTION})["detail"]
    many = [0.001 * i for i in range(11)]
    assert refused(413, to="csv", grid={"x_m": many, "y_m": many, "z_m": many})["value"] == "1331"
