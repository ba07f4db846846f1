"""One diagnosis as it is reported: had the readings said something else, and as the words of its page."""

from __future__ import annotations

import html
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimator.diagnosis.mixture.naming import named_by
from estimator.diagnosis.report import diagnosis_report
from estimator.diagnosis.result import Diagnosis
from estimator.diagnosis.verdict import Verdict
from estimator.rig.rig import Cause
from tests.estimator.diagnosis.mixture.hand_made import Drawn, said

OFFSET, HEATING = Cause("sensor_offset", "hall"), Cause("coil_heating", "coil1")
GAIN, STEPS, WANDERS = Cause("axis_gain", "hall"), Cause("gain_steps", "hall"), Cause("zero_wanders", "hall")
RADIUS = "coil1.radius_m"


def as_text(diagnosis: Diagnosis) -> str:
    """The page without figures and tags."""
    page = re.sub(r"<img[^>]*>", "", diagnosis_report(diagnosis, "coilcal diagnose session.zarr"))
    return re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", page)))


def said_instead(
    diagnosis: Diagnosis, drawn: Drawn, slots: Sequence[Mapping[Cause, float]] = ()
) -> Diagnosis:
    """The diagnosis, had the readings said this."""
    answer = said(diagnosis.findings.answer.first, drawn, slots)
    named = tuple(named_by(answer))
    verdict = Verdict.PARTLY_EXPLAINED if named else Verdict.UNEXPLAINED
    findings = replace(diagnosis.findings, answer=answer, causes=named)
    left_open = replace(diagnosis.left_open, next_measurements=())
    return replace(diagnosis, verdict=verdict, findings=findings, left_open=left_open)
