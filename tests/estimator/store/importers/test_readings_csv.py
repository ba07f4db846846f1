"""A readings CSV is read back as written, and every error names file, line and column."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from estimator.errors import Faults, InvalidInput
from estimator.readings.clock import Clock
from estimator.rig.rig import Rig
from estimator.rig_files.read import rig_from_text
from estimator.store.importers.forms.recipe import Recipe
from estimator.store.importers.forms.understand import understood
from estimator.store.importers.readings_csv import is_readings_csv, read_readings_csv, write_readings_csv
from estimator.store.session import Session
from tests.estimator.store.test_session import make_session

ONE_SENSOR = """
schema_version: 1
name: one sensor
movers: {arm1: {motion: displacement}}
coils: {coil1: {carried_by: arm1, radius_mm: 50, wire_radius_mm: 1, axial_loops: 2, radial_loops: 2}}
sensors: {hall: {noise_uT: 20}}
"""
HEADER = "t_s,coil1_current_A,arm1_x_m,arm1_y_m,arm1_z_m,Bx_T,By_T,Bz_T"
ROW = "0,3,0.01,0.02,0.03,1e-3,2e-3,3e-3"
NEXT = "1" + ROW[1:]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_from_text(ONE_SENSOR)


def written(path: Path, *lines: str) -> Path:
    (path / "readings.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path / "readings.csv"


def test_a_written_session_is_read_back_bit_by_bit(tmp_path):
    made = make_session()
    segment = torch.randint(-1, 4, (len(made.observations),), generator=torch.Generator().manual_seed(1))
    readings = replace(made.observations, current_measured_A=None, recorded_segment=segment)
    session = Session(made.rig, readings, "test")
    write_readings_csv(session, tmp_path / "readings.csv")
    assert read_readings_csv(tmp_path / "readings.csv", made.rig).hash == session.hash


def test_columns_may_come_in_any_order_and_any_unit(tmp_path, rig):
    path = written(
        tmp_path,
        "Bx_mT,By_G,Bz_uT,arm1_rx_deg,arm1_ry_mrad,arm1_rz_rad,arm1_x_mm,arm1_y_cm,arm1_z_um,coil1_current_mA,t_s",
        "1,2,3,180,5,6,7,8,9,1500,11",
    )
    o = read_readings_csv(path, rig).observations
    torch.testing.assert_close(o.field_sensor_T, torch.tensor([[1e-3, 2e-4, 3e-6]]).double())
    torch.testing.assert_close(
        o.motion["arm1"], torch.tensor([[7e-3, 8e-2, 9e-6, math.pi, 5e-3, 6.0]]).double()
    )
    assert o.current_A.tolist() == [[1.5]]
    assert o.time_s.tolist() == [11.0]


def test_without_optional_columns_nothing_is_rotated_or_repeated_or_kept_out(tmp_path, rig):
    o = read_readings_csv(written(tmp_path, HEADER, ROW), rig).observations
    assert o.motion["arm1"].tolist() == [[0.01, 0.02, 0.03, 0.0, 0.0, 0.0]]
    assert (o.sensor.tolist(), o.repeat.tolist(), o.is_validation.tolist()) == ([0], [0], [False])
    assert not o.temperature_C


@pytest.mark.parametrize(
    ("cells", "expected", "told"),
    [
        (("7", "7", "2"), [7, 7, 2], ""),
        (("", "3", ""), [-1, 3, -1], ""),
        (("plane b", "", "plane a"), [0, -1, 1], "; segment 0 is plane b; segment 1 is plane a"),
        (("2", "-1", "2"), [0, 1, 0], "; segment 0 is 2; segment 1 is -1"),
    ],
)
def test_segments_have_numbers_or_labels(tmp_path, rig, cells, expected, told):
    rows = [f"{i}{ROW[1:]},{cell}" for i, cell in enumerate(cells)]
    session = read_readings_csv(written(tmp_path, HEADER + ",segment", *rows), rig)
    assert session.observations.segment.tolist() == expected
    assert session.source == f"readings CSV readings.csv{told}"


def test_an_empty_field_cell_is_a_component_that_was_not_measured(tmp_path, rig):
    o = read_readings_csv(written(tmp_path, HEADER, "0,3,0,0,0,,2e-3,  "), rig).observations
    assert o.is_measured.tolist() == [[False, True, False]]


def test_byte_order_mark_windows_line_ends_and_blank_lines_are_tolerated(tmp_path, rig):
    path = tmp_path / "readings.csv"
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join([HEADER, ROW, "", NEXT, "", ""]).encode())
    assert len(read_readings_csv(path, rig).observations) == 2


def test_the_earliest_date_is_that_of_the_session(tmp_path, rig):
    """A backlog then spreads over its true dates in history."""
    dates = (",2025-03-02T10:00:00+01:00", ",2025-03-02T08:59:00+00:00")
    rows = (ROW + dates[0], NEXT + dates[1])
    session = read_readings_csv(written(tmp_path, HEADER + ",recorded_at", *rows), rig)
    assert session.created == "2025-03-02T08:59:00+00:00"
    with pytest.raises(InvalidInput, match="recorded_at must hold a date in some line"):
        read_readings_csv(written(tmp_path, HEADER + ",recorded_at", ROW + ",", NEXT + ","), rig)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((HEADER,), "at least one reading"),
        ((HEADER, ROW, NEXT[:-5]), "8 cells like the header; received 7"),
        ((HEADER, ROW, NEXT + ",1"), "8 cells like the header; received 9"),
        (
            (HEADER, ROW, NEXT.replace("3,", ",", 1)),
            "coil1_current_A must be a finite number; received ''; write 0 where no current flowed",
        ),
        ((HEADER, ROW, NEXT.replace("0.02", "inf")), "arm1_y_m must be a finite number; received 'inf'"),
        ((HEADER, ROW, NEXT.replace("1e-3", "1_0")), "Bx_T must be a finite number; received '1_0'"),
        ((HEADER, ROW, NEXT.replace("1e-3", "1e-3 T")), "Bx_T must be a finite number; received '1e-3 T'"),
        ((HEADER, "0,3,0,0,0,,,"), "at least one reading; all its rows were left out"),
        ((HEADER, ROW, ROW), "t_s = 0 is in lines 2 and 3"),
        (
            (HEADER + ",sensor", ROW + ",hall", NEXT + ",hal"),
            "sensor must be one of hall; received 'hal'",
        ),
        (
            (HEADER + ",set", ROW + ",validation", NEXT + ",test"),
            "set must be one of calibration, validation",
        ),
        ((HEADER + ",repeat", ROW + ",1", NEXT + ",1.5"), "repeat must be a whole number"),
        ((HEADER + ",repeat", ROW + ",1", NEXT + ",-1"), "repeat must be a whole number"),
        ((HEADER + ",repeat", ROW + ",1", NEXT + ",1e300"), "repeat must be a whole number"),
        ((HEADER + ",segment", ROW + ",1", NEXT + ",1000000000"), "segment must be a whole number"),
        ((HEADER + ",recorded_at", ROW + ",2025-01-01", NEXT + ",soon"), "recorded_at must be a date"),
        (
            (HEADER + ",recorded_at", ROW + ",", NEXT + ",2999-01-01"),
            "recorded_at must be a date such as 2026-03-01 or 2026-03-01T09:30+01:00, and not in the future",
        ),
    ],
)
def test_a_fault_is_one_sentence_that_names_the_file(tmp_path, rig, lines, message):
    with pytest.raises(InvalidInput) as caught:
        read_readings_csv(written(tmp_path, *lines), rig)
    sentence = str(caught.value)
    assert message in sentence
    assert "readings.csv" in sentence
    assert "\n" not in sentence
    if len(lines) > 2 and lines[1] != lines[2]:
        assert "line 3" in sentence


def test_the_line_number_counts_blank_lines(tmp_path, rig):
    with pytest.raises(InvalidInput, match="line 5"):
        read_readings_csv(written(tmp_path, HEADER, "", ROW, "", NEXT.replace("1e-3", "x")), rig)


@pytest.mark.parametrize(
    "header",
    [
        "",
        HEADER.replace("arm1_y_m,", ""),
        HEADER.replace("Bz_T", "Bz"),
        HEADER.replace("Bz_T", "Bz_mm"),
        HEADER.replace("Bz_T", "Bz_kT"),
        HEADER.replace("arm1_x_m", "ux_m"),
        HEADER + ",",
        HEADER + ",Bx_T",
        HEADER + ",Bx_mT",
        HEADER + ",humidity",
        HEADER + ",coil2_temperature_C",
        HEADER + ",arm1_rx_rad,arm1_rz_rad",
        HEADER.replace(",", ";"),
        HEADER.replace("Bz_T", '"Bz_T'),
    ],
)
def test_another_header_is_none_of_a_readings_csv(tmp_path, rig, header):
    assert is_readings_csv(written(tmp_path, HEADER, ROW), rig)
    assert not is_readings_csv(written(tmp_path, header, ROW), rig)
    with pytest.raises(
        InvalidInput, match="must begin with the header of a readings CSV of rig 'one sensor'"
    ):
        read_readings_csv(written(tmp_path, header, ROW), rig)


def test_several_sensors_need_their_column(tmp_path):
    rig = rig_from_text(ONE_SENSOR.replace("{hall:", "{squid: {noise_uT: 20}, hall:"))
    assert not is_readings_csv(written(tmp_path, HEADER, ROW), rig)
    header, rows = HEADER + ",sensor", (ROW + ",hall", ROW + ",squid")
    assert read_readings_csv(written(tmp_path, header, *rows), rig).observations.sensor.tolist() == [1, 0]


def test_joint_angles_must_not_be_left_out(tmp_path):
    rig = rig_from_text(ONE_SENSOR.replace("displacement", "UR3"))
    assert not is_readings_csv(written(tmp_path, "t_s,coil1_current_A,Bx_T,By_T,Bz_T", "0,1,1,1,1"), rig)


def test_unreadable_files_are_refused(tmp_path, rig):
    for name in ("missing.csv", "."):
        with pytest.raises(InvalidInput, match="must be readable"):
            understood(tmp_path / name, rig)


def test_an_unwritable_folder_is_refused(tmp_path, rig):
    session = read_readings_csv(written(tmp_path, HEADER, ROW), rig)
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="must be writable"):
        write_readings_csv(session, tmp_path / "file" / "readings.csv")


def faults_of(path: Path, rig: Rig) -> list[InvalidInput]:
    """All that is wrong with the rows of a file."""
    faults = Faults(is_collected=True)
    with faults.noting():
        understood(path, rig, faults=faults)
    return faults.noted


def test_one_stray_quote_loses_no_rows(tmp_path, rig):
    """To a reader that takes line ends into cells, rows 151 to 279 are the label of a segment."""
    rows = [f"{i}{ROW[1:]},day 1" for i in range(280)]
    rows[150] = rows[150].replace("day 1", '"day 1')
    path = written(tmp_path, HEADER + ",segment", *rows)
    with pytest.raises(
        InvalidInput, match=r"a quote must enclose a whole cell; cell 9 .*readings.csv, line 152"
    ):
        read_readings_csv(path, rig)
    assert len(faults_of(path, rig)) == 1


def test_a_cell_of_5000_digits_is_not_quoted_whole(tmp_path, rig):
    for cell in ("9" * 5000, "x" * 5000):
        for line in range(len(HEADER.split(","))):
            cells = NEXT.split(",")
            cells[line] = cell
            with pytest.raises(InvalidInput, match="line 3") as caught:
                read_readings_csv(written(tmp_path, HEADER, ROW, ",".join(cells)), rig)
            assert len(str(caught.value)) < 400
    with pytest.raises(InvalidInput) as caught:
        read_readings_csv(written(tmp_path, HEADER + "," + "x" * 5000, ROW + ",1"), rig)
    assert len(str(caught.value)) < 700


def test_a_hundred_thousand_columns_are_refused_at_once(tmp_path, rig):
    names, cells = (",".join(f"{name}{i}" for i in range(100_000)) for name in ("x", ""))
    path = written(tmp_path, f"{HEADER},{names}", f"{ROW},{cells}")
    begin_s = time.process_time()
    with pytest.raises(InvalidInput, match="a line must have at most 100000 characters"):
        understood(path, rig)
    assert time.process_time() - begin_s < 5.0


def test_one_cause_of_three_thousand_rows_is_one_sentence(tmp_path, rig):
    rows = [f"{i}{ROW[1:]}".replace("1e-3", "high") for i in range(3000)]
    (fault,) = faults_of(written(tmp_path, HEADER, *rows), rig)
    places = "received 'high' in line 2, 'high' in line 3, 'high' in line 4 and 2997 more"
    assert f"Bx_T must be a finite number; {places}; no row has: convert the column" in str(fault)
    (fault,) = faults_of(written(tmp_path, HEADER, *[ROW + ",1"] * 9), rig)
    assert "received 9 in line 2, 9 in line 3, 9 in line 4 and 6 more; no line has: where commas" in str(
        fault
    )


def test_words_for_no_reading_are_components_that_were_not_measured(tmp_path, rig):
    rows = (ROW, NEXT.replace("1e-3", "OVLD"), "2,3,0,0,0,nan,9.9E37,1e-3", "3,3,0,0,0,--,,NaN")
    read = understood(written(tmp_path, HEADER, *rows), rig)
    is_measured = read.readings.observations.is_measured
    assert is_measured.tolist() == [[True] * 3, [False, True, True], [False, False, True]]
    assert read.table.notes == [
        "5 cells of fields count as not measured: OVLD in line 3, nan in line 4, 9.9e+37 in line 4 and 2 more.",
        "1 row left out (line 5): no component of the field was measured.",
    ]


def test_what_a_log_repeats_or_never_wrote_is_no_row(tmp_path, rig):
    path = written(tmp_path, HEADER, ROW, HEADER, NEXT)
    with path.open("ab") as file:
        file.write(b"\0" * 300)
    assert len(read_readings_csv(path, rig).observations) == 2


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (NEXT[:-5], "1 line left out (line 3): a row must have 8 cells like the header."),
        (NEXT + '"', "1 line left out (line 3): a quote must enclose a whole cell."),
        (NEXT + "\0", "1 line left out (line 3): a line must hold text."),
        (NEXT.replace("3,", "x,", 1), "1 row left out (line 3): a cell has a fault."),
        (ROW, "1 row left out (line 3): a cell has a fault."),
    ],
)
def test_bad_lines_are_left_out_where_that_is_asked_for(tmp_path, rig, bad, words):
    path = written(tmp_path, HEADER, ROW, bad, "2" + ROW[1:])
    with pytest.raises(InvalidInput, match="--skip-bad-lines|--clock spread"):
        read_readings_csv(path, rig)
    read = understood(path, rig, Recipe(skips_bad=True))
    assert (read.readings.observations.time_s.tolist(), read.table.notes) == ([0.0, 2.0], [words])


def test_stamps_that_are_shared_and_clocks_set_back_have_a_cure(tmp_path, rig):
    shared = written(tmp_path, HEADER, *[f"{stamp}{ROW[1:]}" for stamp in (0, 0, 1, 1, 2, 2)])
    with pytest.raises(InvalidInput, match="t_s = 0 is in lines 2 and 3, t_s = 1 is in .* --clock spread"):
        read_readings_csv(shared, rig)
    session = read_readings_csv(shared, rig, Clock.SPREAD)
    assert session.observations.time_s.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]
    back = written(tmp_path, HEADER, *[f"{stamp}{ROW[1:]}" for stamp in (0, 1, 2, 0, 1, 2)])
    with pytest.raises(
        InvalidInput, match="time jumps back in line 5: go on behind it with --clock continue"
    ):
        read_readings_csv(back, rig)
    for clock in (Clock.CONTINUE, Clock.ROWS):
        assert read_readings_csv(back, rig, clock).observations.time_s.tolist() == [0, 1, 2, 3, 4, 5]
