"""Words that are markup, wherever somebody can store them, are shown as words by the page: `make browser`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi import FastAPI

from estimator.calibration.report import calibration_report
from estimator.calibration.result import Calibration
from estimator.diagnosis.panel_records import (
    Answer,
    Moved,
    NextMeasurement,
    Panels,
    Race,
    ResidualMap,
    Runner,
    Shown,
)
from estimator.recalibration.log import Entry
from estimator.recalibration.registry import Registry
from estimator.rig_files.read import rig_from_text
from estimator.service.app import create_app
from estimator.service.core import Core
from estimator.service.database import new_id, now
from estimator.service.schema import Job
from estimator.service.settings import Settings
from estimator.service.tasks import PANELS, TASKS
from estimator.service.work import PROGRESS
from tests.estimator.service.conftest import CHROMIUM, import_csv, listening, upload_rig

pytest.importorskip("playwright.sync_api")
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")]
MARK = """'\"><img src=x onerror="window.ran=1"><script>window.ran=1</script><b id=bold>&lt;i&gt;${1}</b>"""
FOUND = "document.querySelectorAll('img, script:not([src]), #bold, [onerror]').length"


@dataclass(frozen=True)
class Marked:
    """A service in whose every text there is markup."""

    url: str
    rig_id: str
    jobs: dict[str, str]


@pytest.fixture
def marked(
    tmp_path: Path, rig_text: str, readings_csv: bytes, small_calibration: Calibration
) -> Iterator[Marked]:
    settings = Settings(data=tmp_path / "data")
    app = create_app(settings, has_workers=False)
    with listening(app, settings) as port, httpx.Client(base_url=f"http://127.0.0.1:{port}") as client:
        rig_id = upload_rig(client, rig_text.replace("name: small", f"name: {json.dumps(MARK)}"))
        session_id = import_csv(client, rig_id, readings_csv)["id"]
        client.post("/v1/sessions", json={"rig_id": rig_id, "source": MARK}).raise_for_status()
        labels = {"name": MARK[:200], "note": MARK}
        client.patch(f"/v1/sessions/{session_id}", json=labels).raise_for_status()
        registry = Registry(app.state.core.registry_path(MARK))
        entry = Entry(
            "drifted", MARK, f"{session_id}.zarr", taken="2026-11-24T03:00:00", causes=[{"name": MARK}]
        )
        with registry.writing():
            registry.commit(replace(entry, conclusion="updated", hash="1" * 64), small_calibration)
            registry.commit(replace(entry, hash="2" * 64))
        named = replace(small_calibration, rig=replace(small_calibration.rig, name=MARK))
        yield Marked(str(client.base_url), rig_id, stored_jobs(app, session_id, named))


def stored_jobs(app: FastAPI, session_id: str, calibration: Calibration) -> dict[str, str]:
    """Jobs of every kind and state, as workers leave them."""
    core: Core = app.state.core
    of_design = {"goal": MARK, "so_far": 1.0, "reached": [0.5], "unit": "m", "plan": MARK}
    of_design["programmes"] = [{"action": MARK, "expected_log_evidence": 1.0}]
    fit = {"session": session_id, "coil": MARK, "hypothesis": MARK, "probability": 0.9, MARK: 1.0}
    entry = Entry("drifted", MARK, session_id, causes=[{"name": MARK}])
    parameter = {"unit": MARK, "median": 1.0, "sd": 0.1, "ci90": [0.8, 1.2]}
    results: dict[str, Any] = {
        "calibrate": {"quality": {"verdict": MARK}, "is_converged": False, "parameters": {MARK: parameter}},
        "diagnose": {"verdict": "named"},
        "recalibrate": asdict(entry),
        "batch": {"fits": [fit], "failed": {session_id: MARK}},
        "design": of_design,
        "running": {},
        "failed": {},
    }
    page = calibration_report(calibration, MARK)
    ids = {}
    for name, result in results.items():
        kind = name if name not in ("running", "failed") else "calibrate"
        state = "done" if kind == name else name
        ids[name] = new_id()
        job = Job(id=ids[name], kind=kind, state=state, session_id=session_id, rig_id=None, options={})
        job.note = MARK
        job.user, job.created, job.starts, job.fault = MARK, now(), 1, MARK if name == "failed" else None
        with core.database.writing() as db:
            db.add(job)
        path = core.jobs.folder(ids[name]) / TASKS[kind].result
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(result), encoding="utf-8")
        if (report := TASKS[kind].report) is not None:
            (core.jobs.folder(ids[name]) / report).write_text(page, encoding="utf-8")
        line = {"time_s": 1.0, "words": MARK}
        (core.jobs.folder(ids[name]) / PROGRESS).write_text(json.dumps(line) + "\n", encoding="utf-8")
    folder = core.jobs.folder(ids["diagnose"])
    (folder / PANELS).write_text(json.dumps(asdict(panels())), encoding="utf-8")
    (folder / "diagnosis" / "rig_extended.yaml").write_text(MARK, encoding="utf-8")
    return ids


def panels() -> Panels:
    places = [[0.0, 0.0, 0.0], [0.01, 0.0, 0.02]]
    runners = [Runner(MARK, MARK, 5.0, "named", 1.0), Runner("nothing", MARK, 0.0, "other", 2.0)]
    return Panels(
        rig=MARK,
        source=MARK,
        verdict="named",
        headline=[MARK, MARK],
        warnings=[MARK],
        answers=[Answer(MARK, MARK, MARK, MARK, 0.9, [MARK, MARK], [(MARK, 0.05)])],
        n_readings=2,
        noise_T=1e-6,
        left_sigma=(2.0, 1.0),
        maps=[ResidualMap(MARK, None, places, places, places, {MARK: places})] * 2,
        races=[Race(MARK, runners)] * 2,
        moved=[Moved(Shown(MARK, MARK, MARK, 1.0), (0.0, 1.0), (1.0, 1.0), 2.0, {MARK: 1.0})],
        moved_words=MARK,
        next=[NextMeasurement(MARK, MARK, MARK, MARK, 3)],
    )


def test_markup_is_shown_as_words_everywhere(marked, page):
    views = ["rigs", "sessions", "jobs", f"history/{marked.rig_id}", "new/batch", "new/design"]
    for view in [*views, *(f"jobs/{job_id}" for job_id in marked.jobs.values())]:
        page.goto(f"{marked.url}/#/{view}")
        page.locator("main", has_text=MARK).wait_for()
        page.wait_for_timeout(200)
        assert page.evaluate(FOUND) == 0, view
    for name in ("calibrate", "diagnose"):
        page.goto(f"{marked.url}/v1/jobs/{marked.jobs[name]}/report")
        page.locator("h1", has_text=MARK).wait_for()
        assert page.evaluate("document.querySelectorAll('#bold, [onerror], script').length") == 0
    assert page.evaluate("window.ran") is None


def test_what_a_refusal_repeats_is_words(marked, page, rig_text, tmp_path):
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig_text.replace("hall:", f"{json.dumps(MARK)}:"), encoding="utf-8")
    assert rig_from_text(rig_text).sensors[0].name == "hall"
    page.goto(f"{marked.url}/#/rigs")
    page.get_by_label("Rig file").set_input_files(rig)
    page.get_by_role("button", name="Upload").click()
    page.get_by_role("alert").filter(has_text="onerror").wait_for()
    assert page.evaluate(FOUND) == 0
    page.goto(f"{marked.url}/#/jobs/<img src=x onerror=window.ran=1>")
    page.get_by_role("alert").wait_for()
    page.goto(f"{marked.url}/#/new/<b id=bold>")
    page.get_by_role("alert").wait_for()
    assert page.evaluate(FOUND) == 0
    assert page.evaluate("window.ran") is None
