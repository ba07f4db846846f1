"""A laboratory's path through the page in a real browser: `make browser`.

Screenshots of what it shows, wide and narrow, light and dark, go to the folder that `COILCAL_SCREENSHOTS` names.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
import re
import time
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import httpx
import pytest
from click.testing import CliRunner

from estimator.cli.main import main
from estimator.readings.plan import load_plan
from estimator.recalibration.registry import Registry
from estimator.rig.rig import Cause, Rig
from estimator.store.session import Session
from estimator.store.zipped import zipped
from tests.estimator.diagnosis.small_fits import with_wrong
from tests.estimator.service.conftest import CHROMIUM, Served, append, begin_session, lines_of, upload_rig

pytest.importorskip("playwright.sync_api")
axe = pytest.importorskip("axe_playwright_python.sync_playwright")
pytestmark = [pytest.mark.browser, pytest.mark.skipif(CHROMIUM is None, reason="needs chromium")]
OFFSET, OFFSET_T = Cause("sensor_offset", "hall"), 2e-4
PATIENCE_MS = 180_000
BURST_MS = 1_100  # Chromium drops what a page downloads after ten files without a pause of a second
LOOKS = [(1280, "light"), (1280, "dark"), (390, "light"), (390, "dark")]


@pytest.fixture
def flawed(small_session: Session, small_rig: Rig) -> Session:
    """The small rig with an offset that nobody mentioned, which it cannot tell from a field of the room."""
    wrong = with_wrong(small_rig, small_session.observations, OFFSET, {"x_T": OFFSET_T})
    return replace(small_session, observations=wrong)


def check(page: Any, name: str) -> None:
    """No serious finding of axe at any width and in any light, nothing wider than the screen, and a picture of each."""
    folder = os.environ.get("COILCAL_SCREENSHOTS")
    for width, light in LOOKS:
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=light, reduced_motion="reduce")
        page.wait_for_timeout(200)
        found = axe.Axe().run(page).response["violations"]
        serious = [
            (one["id"], node["html"][:200])
            for one in found
            if one["impact"] in ("serious", "critical")
            for node in one["nodes"]
        ]
        assert serious == [], (name, width, light)
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), (name, width)
        if folder:
            page.screenshot(path=Path(folder) / f"{name}_{width}_{light}.png", full_page=True)
    page.set_viewport_size({"width": 1280, "height": 900})
    is_asked = page.locator("dialog[open]").count()  # nothing behind a question can be pressed
    for drawn in [] if is_asked else page.locator("figure").all():
        check_figure(page, drawn)


def check_figure(page: Any, drawn: Any) -> None:
    """A figure leaves as SVG, PNG and CSV; no row of the table is torn, and no number is missing unsaid."""
    page.wait_for_timeout(BURST_MS)
    svg = downloaded(page, drawn.get_by_role("button", name="SVG"))
    assert ElementTree.fromstring(svg).tag == "{http://www.w3.org/2000/svg}svg"
    assert b'stroke="rgb(' in svg  # it looks the same without the style sheet
    assert downloaded(page, drawn.get_by_role("button", name="PNG")).startswith(b"\x89PNG")
    table = downloaded(page, drawn.get_by_role("button", name="CSV")).decode()
    header, *rows = csv.reader(io.StringIO(table))
    assert rows, header
    assert {len(row) for row in rows} == {len(header)}
    assert not re.search(r"undefined|NaN|null|\[object", table), table[:500]


def uploaded(service: Served, session: Session, rig_text: str, folder: Path) -> str:
    """Gives the service a closed session; the id of its rig."""
    rig_id = upload_rig(service.client, rig_text)
    session.save(folder / "session.zarr")
    call = {"content": zipped(folder / "session.zarr"), "headers": {"Content-Type": "application/zip"}}
    answer = service.client.post("/v1/sessions/import-zip", params={"rig_id": rig_id}, **call)
    assert answer.status_code == 201, answer.text
    return rig_id


def downloaded(page: Any, button: Any) -> bytes:
    with page.expect_download() as download:
        button.click()
    return Path(download.value.path()).read_bytes()


def test_a_hidden_cause_is_diagnosed_read_and_accepted(served, page, flawed, rig_text, tmp_path):
    service = served()
    upload_rig(service.client, rig_text)
    flawed.save(tmp_path / "session.zarr")
    archive = tmp_path / "session.zip"
    archive.write_bytes(zipped(tmp_path / "session.zarr"))
    page.goto(service.url)
    page.get_by_role("link", name="Sessions").click()
    page.get_by_label("Readings (CSV or another table, or a zipped session)").set_input_files(archive)
    page.get_by_role("button", name="Upload").click()
    page.get_by_role("button", name="Diagnose").wait_for()
    check(page, "sessions")
    page.get_by_role("button", name="Diagnose").click()
    verdict = page.locator("#verdict")
    verdict.wait_for(timeout=PATIENCE_MS)
    assert "sensor_offset" in verdict.inner_text()
    assert "background_field" in verdict.inner_text()
    where = page.locator(".tile", has_text="Where").first.inner_text().split()
    assert where[1] in ("room", "hall")
    check(page, "diagnosis")

    before = page.locator(".before svg")
    drawn = before.inner_html()
    before.focus()
    page.keyboard.press("ArrowLeft")
    page.wait_for_timeout(100)
    assert before.inner_html() != drawn
    first = page.locator("figure").first
    rows = downloaded(page, first.get_by_role("button", name="CSV")).decode().splitlines()
    assert rows[0] == "x_m,y_m,z_m,Bx_T,By_T,Bz_T"
    assert len(rows) == 1 + len(flawed.observations.calibration)
    plan = tmp_path / "plan.yaml"
    plan.write_bytes(downloaded(page, page.get_by_role("button", name="Plan of proposal 1")))
    assert load_plan(plan, flawed.rig).stops

    page.get_by_role("button", name="Accept the extended rig").click()
    page.get_by_text("is kept").wait_for()
    page.get_by_role("link", name="Rigs").click()
    page.get_by_text("2 versions").wait_for()
    versions = service.client.get("/v1/rigs", params={"name": "small"}).json()["items"]
    accepted = service.client.get(f"/v1/rigs/{versions[0]['id']}/text").text
    assert "sensor_offset" in accepted or "background_field" in accepted
    check(page, "rigs")
    page.get_by_role("link", name="Jobs").click()
    page.get_by_text("done", exact=True).wait_for()
    check(page, "jobs")


def test_columns_of_another_table_are_shown_chosen_and_imported(
    served, page, rig_text, readings_csv, tmp_path
):
    service = served()
    upload_rig(service.client, rig_text)
    header, *rows = readings_csv.decode().splitlines()
    odd = [header.replace("Bx_T", "Probe 7 [T]").replace("t_s", "stamp"), *rows]
    (tmp_path / "lab.csv").write_text("Monday\n" + "\n".join(odd).replace(",", ";"), encoding="utf-8")
    page.goto(f"{service.url}/#/sessions")
    page.locator("input[type=file]").set_input_files(tmp_path / "lab.csv")
    page.get_by_role("button", name="Upload").click()
    page.get_by_label("What Probe 7 [T] is").wait_for()
    check(page, "columns")
    assert service.client.get("/v1/sessions").json()["items"] == []
    page.get_by_label("What stamp is").select_option("t_ms")
    page.get_by_label("What Probe 7 [T] is").select_option("Bx_T")
    page.get_by_text("readings. Are these numbers right?").wait_for()
    page.get_by_role("button", name="Import it so").click()
    page.get_by_role("button", name="Diagnose").wait_for()
    page.get_by_text("Labels", exact=True).click()
    page.get_by_role("textbox", name="Name").fill("Coil 7")
    page.get_by_label("Tags").fill("cold, monday")
    page.get_by_role("button", name="Save").click()
    page.get_by_role("heading", name="Coil 7").wait_for()
    check(page, "labels")
    page.get_by_label("Search sessions").fill("warm")
    page.get_by_role("button", name="Search").click()
    page.get_by_text("No session has these words.").wait_for()
    (session,) = service.client.get("/v1/sessions", params={"search": "monday"}).json()["items"]
    again = service.client.get(f"/v1/sessions/{session['id']}/readings.csv").text.splitlines()
    assert float(again[2].split(",")[0]) == pytest.approx(1e-3 * float(rows[1].split(",")[0]))


def test_what_a_cause_would_do_follows_the_slider(served, page, small_session, rig_text, tmp_path):
    service = served()
    rig_id = upload_rig(service.client, rig_text)
    small_session.save(tmp_path / "session.zarr")
    call = {"content": zipped(tmp_path / "session.zarr"), "headers": {"Content-Type": "application/zip"}}
    answer = service.client.post("/v1/sessions/import-zip", params={"rig_id": rig_id}, **call)
    page.goto(f"{service.url}/#/what-if/{answer.json()['id']}")
    page.get_by_label("Cause").select_option("sensor_offset[hall]")
    page.get_by_text("the sensor has a zero offset").wait_for()
    slider = page.get_by_label("Size of sensor_offset[hall]")
    said = page.locator("section[aria-live] strong")
    small = float(said.inner_text().split()[0])
    slider.focus()
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    assert float(said.inner_text().split()[0]) > 1.2 * small
    check(page, "what_if")


def test_an_open_session_is_watched_by_who_has_logged_in(
    served, page, small_session, small_rig, rig_text, tmp_path
):
    config = tmp_path / "service.yaml"
    config.write_text("require_tokens: true\n", encoding="utf-8")
    call = ["serve", "token", "create", "--user", "anne", "--data", str(tmp_path / "data")]
    token = CliRunner().invoke(main, call).stdout.strip()
    service = served("--config", config)
    page.goto(service.url)
    check(page, "login")
    page.get_by_label("Token").fill("wrong")
    page.get_by_role("button", name="Log in").click()
    page.get_by_text("token must be one that exists").wait_for()
    page.get_by_label("Token").fill(token)
    page.get_by_role("button", name="Log in").click()
    page.get_by_text("anne (write)").wait_for()
    with httpx.Client(base_url=service.url, headers={"Authorization": f"Bearer {token}"}) as client:
        session_id = begin_session(client, upload_rig(client, rig_text))
        page.get_by_role("link", name="Sessions").click()
        page.get_by_role("link", name="Watch").click()
        page.get_by_text("being measured").wait_for()
        n = len(small_session.observations)
        for row in range(n):
            reading = json.loads(lines_of(small_session, small_rig, row, row + 1))
            if row < n - 2:  # then the supply falls silent
                reading |= {"measured_A": dict(reading["current_A"]), "temperature_C": {"coil1": 24.5}}
            append(client, session_id, json.dumps(reading).encode())
            time.sleep(0.05)
        page.get_by_text(f"reading {n}, hall").wait_for()
        running = page.locator(".tile", has_text="Running diagnosis")
        running.filter(has_text="after ").wait_for(timeout=PATIENCE_MS)
        assert "nothing found" in running.inner_text()
        estimate = page.get_by_role("region", name="Estimate")
        estimate.get_by_text("Polished: the same as a fit of all readings so far.").wait_for()
        residuals = page.locator("svg.space").inner_html()
        page.get_by_label("Arrows").select_option("field")
        assert page.locator("svg.space").inner_html() != residuals
        assert page.locator("svg.space .ring text").all_text_contents() == ["coil1"]
        assert page.locator("figure").count() == 3
        devices = page.get_by_role("region", name="Devices").get_by_role("row")
        assert "in the last reading" in devices.filter(has_text="sensor hall").inner_text()
        assert " mm" in devices.filter(has_text="mover arm1").inner_text()
        assert "silent for 2 readings" in devices.filter(has_text="supply of coil1").inner_text()
        assert "24.5 °C" in devices.filter(has_text="thermometer of coil1").inner_text()
        check(page, "live")
        client.post(f"/v1/sessions/{session_id}/close")
        page.get_by_text("Nothing follows.").wait_for()
    page.get_by_role("button", name="Log out").click()
    page.get_by_label("Token").wait_for()


def months_of(registry: Registry) -> None:
    """Sessions of eight months in a registry that has one version: a slow change, a drift with its version, a bad one."""
    calibration = registry.calibration(1)
    first = registry.entries()[0]
    values = {name: (one["median"], one["sd"]) for name, one in calibration.summary()["parameters"].items()}
    conclusions = ["unchanged"] * 4 + [
        "updated",
        "unchanged",
        "drifted",
        "unchanged",
        "rejected",
        "unchanged",
    ]
    begin = datetime.fromisoformat(first.taken)
    with registry.writing():
        for number, conclusion in enumerate(conclusions, start=1):
            moved = 3.0 * (number >= 7)
            estimate = {
                name: [m + sd * (0.4 * math.sin(number) + moved), sd] for name, (m, sd) in values.items()
            }
            entry = replace(
                first,
                hash=f"{number:064x}",
                session=f"{number:032x}.zarr",
                taken=(begin + timedelta(days=24 * number)).isoformat(),
                conclusion=conclusion,
                reason=f"session {number} of a simulated year",
                made=None,
                version=registry.current,
                causes=[{"name": "sensor_offset"}] if conclusion == "drifted" else [],
                estimate=estimate,
            )
            has_version = conclusion in ("updated", "drifted")
            registry.commit(entry, calibration if has_version else None)


def test_a_rig_is_followed_over_months_and_rolled_back_after_a_question(
    served, page, small_session, rig_text, tmp_path
):
    """A recalibration is asked for by its form; months that follow it are written as recalibrations write them."""
    service = served()
    rig_id = uploaded(service, small_session, rig_text, tmp_path)
    page.goto(f"{service.url}/#/jobs")
    page.get_by_role("navigation", name="New job").get_by_role("link", name="Recalibration").click()
    page.get_by_label("Session").wait_for()
    check(page, "new_recalibration")
    page.get_by_role("button", name="Start").click()
    page.get_by_text("It made version 1.").wait_for(timeout=PATIENCE_MS)
    check(page, "recalibration")
    (folder,) = (tmp_path / "data" / "registries").iterdir()
    months_of(Registry(folder))
    page.get_by_role("link", name="This rig over time").click()
    page.get_by_text("Version 3 is in use.").wait_for()
    figure = page.get_by_role("img", name="Parameters of small over time")
    assert figure.locator(".mark.drifted").count() == 1 + figure.locator("text.named").count()
    check(page, "history")
    rows = (
        downloaded(page, page.get_by_role("button", name="Parameters over time as CSV")).decode().splitlines()
    )
    assert rows[0].split(",")[:2] == ["kind", "version"]
    periods = [
        line.split(",") for line in rows if "coil1.radius_m" in line and line.startswith("version in use")
    ]
    assert [period[1] for period in periods] == ["1", "2", "3"]
    known = service.client.get(f"/v1/rigs/{rig_id}/registry/versions").json()["items"][0]["parameters"]
    assert float(periods[2][7]) == known["coil1.radius_m"]["median"]

    page.get_by_role("button", name="Return to version 1").click()
    question = page.get_by_role("dialog")
    question.get_by_text("Return to version 1?").wait_for()
    check(page, "roll_back")
    page.keyboard.press("Escape")
    question.wait_for(state="hidden")
    assert service.client.get(f"/v1/rigs/{rig_id}/registry").json()["current"] == 3
    page.get_by_role("button", name="Return to version 1").click()
    question.get_by_role("button", name="Use version 1").click()
    page.get_by_text("Version 1 is in use.").wait_for()
    assert service.client.get(f"/v1/rigs/{rig_id}/registry").json()["current"] == 1


def test_batches_and_designs_are_asked_for_by_forms(served, page, small_session, rig_text, tmp_path):
    service = served()
    uploaded(service, small_session, rig_text, tmp_path)
    page.goto(f"{service.url}/#/new/batch")
    page.get_by_label("Hypotheses, separated by spaces").fill("plain axis_gain")
    page.get_by_label("Sample the probable hypotheses").uncheck()
    session = page.get_by_role("group", name="Sessions").get_by_role("checkbox")
    session.uncheck()
    page.get_by_role("button", name="Start").click()
    page.get_by_role("alert").get_by_text("session_ids").wait_for()
    assert page.get_by_label("Hypotheses, separated by spaces").input_value() == "plain axis_gain"
    session.check()
    check(page, "new_batch")
    page.get_by_role("button", name="Start").click()
    page.get_by_text("2 fits").wait_for(timeout=PATIENCE_MS)
    check(page, "batch")
    fits = downloaded(page, page.get_by_role("button", name="All parameters as CSV")).decode().splitlines()
    assert len(fits) == 3
    page.goto(f"{service.url}/#/sessions")
    page.get_by_role("link", name="Next readings after").click()
    page.locator("#suggested option[value='coil1.radius_m']").wait_for(state="attached")
    page.get_by_role("combobox", name="Parameter").fill("coil1.radius_m")
    page.get_by_label("Readings to propose").fill("3")
    check(page, "new_design")
    page.get_by_role("button", name="Start").click()
    page.get_by_text("Shrink coil1.radius_m").wait_for(timeout=PATIENCE_MS)
    check(page, "design")
    plan = tmp_path / "plan.yaml"
    plan.write_bytes(downloaded(page, page.get_by_role("button", name="Download the plan")))
    assert len(load_plan(plan, small_session.rig).stops) == 3
    page.goto(f"{service.url}/#/new/design")
    page.get_by_label("Tell causes apart").check()
    page.get_by_role("combobox", name="Causes, separated by spaces").fill("axis_gain")
    page.get_by_role("button", name="Start").click()
    page.get_by_text("a design must split two or more causes").wait_for(timeout=PATIENCE_MS)
