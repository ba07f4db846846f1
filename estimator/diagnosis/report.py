"""The HTML report of one diagnosis: its sentences, tables and figures on a page."""

from __future__ import annotations

from pathlib import Path

from estimator.calibration.report import calibration_report
from estimator.diagnosis.figures import pictures
from estimator.diagnosis.headline import headline, warnings_of
from estimator.diagnosis.part_by_part import part_by_part
from estimator.diagnosis.result import CALIBRATION_FOLDER, REPORT, Diagnosis
from estimator.diagnosis.statements.causes import found_tables, stand_in_tables
from estimator.diagnosis.statements.gain import validation_tables
from estimator.diagnosis.statements.hypotheses import hypotheses_tables
from estimator.diagnosis.statements.left import limits_tables, symptoms_tables
from estimator.diagnosis.statements.moved import moved_tables
from estimator.diagnosis.statements.next_measurement import next_tables
from estimator.diagnosis.statements.readings import flags_tables, outliers_tables
from estimator.diagnosis.statements.visible import visible_tables
from estimator.reporting.page import ReportPage, Table, render_report
from estimator.store.files import write_text

TABLES = (found_tables, flags_tables, outliers_tables, validation_tables, moved_tables, next_tables)
APPENDIX = (symptoms_tables, hypotheses_tables, stand_in_tables, limits_tables, visible_tables)


def diagnosis_report(diagnosis: Diagnosis, command: str) -> str:
    """HTML of one diagnosis, self-contained.

    Args:
        diagnosis: The result of `estimator.diagnose`.
        command: Command that produced it, shown as provenance.
    """
    figures = pictures(diagnosis)
    page = ReportPage(
        title=f"Diagnosis of {diagnosis.rig.name}",
        subtitle=diagnosis.question.source,
        verdict=headline(diagnosis),
        warnings=warnings_of(diagnosis),
        lead=figures[:1],
        tables=part_by_part(TABLES, diagnosis, _missing),
        figures=figures[1:],
        appendix=part_by_part(APPENDIX, diagnosis, _missing),
        provenance={"command": command, "seed": str(diagnosis.question.seed), "rig": diagnosis.rig.hash},
    )
    return render_report(page)


def write_reports(diagnosis: Diagnosis, folder: Path, command: str) -> None:
    """Write the pages of a diagnosis, and of the calibration beside it where there is one.

    Args:
        diagnosis: The result of `estimator.diagnose`.
        folder: Where its files are.
        command: Command that produced it.
    """
    write_text(folder / REPORT, diagnosis_report(diagnosis, command))
    if diagnosis.posterior is not None:
        write_text(folder / CALIBRATION_FOLDER / REPORT, calibration_report(diagnosis.posterior, command))


def _missing(fault: str) -> Table:
    """Stands in the place of a table that could not be made."""
    return Table("A table is missing", ["why"], [[fault]])
