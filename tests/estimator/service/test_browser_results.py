"""What a laboratory reads off the page in a real browser: a calibration, a measurement with alarms, a refused upload (`make browser`)."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from tests.estimator.service.conftest import (
    CHROMIUM,
    QUICK,
    append,
    begin_session,
    import_csv,
    lines_of,
    upload_rig,
)

pytest.importorskip("playwright.sync_api")
pytest.importorskip("axe_playwright_python.sync_playwright")
from tests.estimator.service.test_browser import PATIENCE_MS, check, downloaded

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium"),
]


def test_a_calibration_is_read_and_asked_for_a_point_and_a_plane(served, page, rig_text, readings_csv):
    service = served()
    session = import_csv(service.client, upload_rig(service.client, rig_text), readings_csv)
    job = service.client.post(
        "/v1/jobs/calibrate", json={"session_id": session["id"], "seed": 1, "settings": QUICK}
    ).json()
    page.goto(f"{service.url}/#/jobs/{job['id']}")
    page.get_by_role("heading", name="Predict the field").wait_for(timeout=PATIENCE_MS)
    for title in ("Field of coil1", "What the data taught", "Loop counts", "What the fit leaves"):
        assert page.get_by_role("heading", name=title).count(), title
    page.get_by_label("z (mm)").fill("80")
    page.get_by_role("button", name="Predict").click()
    answer = page.get_by_role("region", name="Prediction")
    answer.get_by_text("T to ").first.wait_for()
    check(page, "calibration")
    page.get_by_label("Where").select_option("plane")
    page.get_by_label("at (mm)").fill("0")
    page.get_by_role("button", name="Predict").click()
    page.get_by_role("heading", name="Half-width of the 90 % interval").wait_for()
    table = downloaded(page, page.get_by_role("button", name="Predicted field as CSV")).decode().splitlines()
    assert len(table) == 1 + 31 * 31
    assert table[0].startswith("x_m,y_m,z_m,Bx_T,By_T,Bz_T,lower_Bx_T")
    places = {tuple(line.split(",")[:3]) for line in table[1:]}
    assert len(places) == 31 * 31
    assert {y for _, y, _ in places} == {"0"}
    check(page, "plane")
    assert b"coil1" in downloaded(page, page.get_by_role("button", name="Export as JSON"))


def test_alarms_are_one_line_and_a_time_line_and_silence_is_told(
    served, page, small_session, small_rig, rig_text
):
    service = served()
    session_id = begin_session(service.client, upload_rig(service.client, rig_text))
    page.goto(f"{service.url}/#/live/{session_id}")
    page.get_by_text("being measured").wait_for()
    fitted = replace(small_session, observations=small_session.observations.calibration.alone)
    n = len(fitted.observations)
    for row in range(n):
        reading = json.loads(lines_of(fitted, small_rig, row, row + 1))
        if row in (n - 3, n - 2):
            reading["field_T"] = {
                name: [-value for value in field_T] for name, field_T in reading["field_T"].items()
            }
        append(service.client, session_id, json.dumps(reading).encode())
        page.wait_for_timeout(50)
    page.get_by_text(f"{n}", exact=True).first.wait_for(timeout=PATIENCE_MS)
    line = page.get_by_role("img", name="Alarms along the session")
    line.wait_for(timeout=PATIENCE_MS)
    assert page.locator(".alarms summary").inner_text().partition(" alarms; the last: ")[0].isdecimal()
    assert line.locator("circle").count() == int(page.locator(".alarms summary").inner_text().split()[0])
    page.get_by_text("No reading for").wait_for(timeout=PATIENCE_MS)
    check(page, "alarms")


def test_a_refused_upload_keeps_the_form_and_shows_each_mistake_with_its_line(
    served, page, rig_text, readings_csv, tmp_path
):
    service = served()
    upload_rig(service.client, rig_text)
    header, *rows = readings_csv.decode().splitlines()
    rows[4] = ",".join(["x", *rows[4].split(",")[1:]])
    rows[8] = rows[8] + ",1"
    (tmp_path / "lab.csv").write_text("\n".join([header, *rows]), encoding="utf-8")
    page.goto(f"{service.url}/#/sessions")
    page.locator("input[type=file]").set_input_files(tmp_path / "lab.csv")
    page.get_by_role("button", name="Upload").click()
    fault = page.get_by_role("alert")
    fault.wait_for()
    told = fault.inner_text()
    assert "line 6" in told, told
    assert "line 10" in told, told
    assert page.locator("input[type=file]").evaluate("(input) => input.files[0].name") == "lab.csv"
    check(page, "refused")
