"""Transcripts of a Kepco BOP and of a supply with plain SCPI."""

from __future__ import annotations

import pytest

from drivers.deadline import Deadline
from drivers.errors import DeadlineExceeded, DeviceFault
from drivers.supplies.scpi import GENERIC, KEPCO_BOP, ScpiSupply, encode_line
from tests.drivers.replay import ScriptedPort, conversation

OK = b'0,"No error"\n'
KEPCO_OK = b'\x130,"No error"\x11\r\n'


def supply(*exchanges, dialect=GENERIC):
    return ScpiSupply(
        conversation(*exchanges),
        dialect=dialect,
        lowest_A=-20.0,
        highest_A=20.0,
        compliance_V=20.0,
        resolution_A=1e-3,
    )


def soon():
    return Deadline.after(1.0)


def test_a_kepco_is_put_under_remote_control_of_its_current():
    kepco = supply(
        (b"SYST:REM 1;:SYST:ERR?\n", KEPCO_OK),
        (b"FUNC:MODE CURR;:SYST:ERR?\n", KEPCO_OK),
        (b"VOLT 20;:SYST:ERR?\n", KEPCO_OK),
        dialect=KEPCO_BOP,
    )
    kepco.prepare(soon())


def test_a_plain_supply_only_gets_its_voltage_limit():
    supply((b"VOLT 20;:SYST:ERR?\n", OK)).prepare(soon())


def test_a_watchdog_is_set_when_the_supply_is_prepared_and_stopped_when_it_is_left():
    port = conversation(
        (b"VOLT 20;:SYST:ERR?\n", OK),
        (b"OUTP:PROT:WDOG:DEL 10;:SYST:ERR?\n", OK),
        (b"OUTP:PROT:WDOG ON;:SYST:ERR?\n", OK),
        (b"OUTP:PROT:WDOG OFF;:SYST:ERR?\n", OK),
    )
    watched = ScpiSupply(
        port, lowest_A=0.0, highest_A=20.0, compliance_V=20.0, resolution_A=1e-3, watchdog_s=10.0
    )
    watched.prepare(soon())
    watched.disarm(soon())


def test_a_supply_without_the_watchdog_that_its_settings_state_is_refused():
    port = conversation(
        (b"VOLT 20;:SYST:ERR?\n", OK), (b"OUTP:PROT:WDOG:DEL 10;:SYST:ERR?\n", b'-113,"Undefined header"\n')
    )
    unwatched = ScpiSupply(
        port, lowest_A=0.0, highest_A=20.0, compliance_V=20.0, resolution_A=1e-3, watchdog_s=10.0
    )
    with pytest.raises(DeviceFault, match="must accept OUTP:PROT:WDOG:DEL 10; it says -113"):
        unwatched.prepare(soon())


def test_the_set_point_is_written_and_read():
    device = supply((b"CURR -1.5;:SYST:ERR?\n", OK), (b"CURR?;:SYST:ERR?\n", b"-1.500E+00;" + OK))
    device.write_set_point(-1.5, soon())
    assert device.read_set_point_A(soon()) == -1.5


def test_a_current_beyond_its_range_is_a_fault_in_its_own_words():
    with pytest.raises(
        DeviceFault, match=r'must accept CURR 25; it says -222,"Data out of range" \(transcript\)'
    ):
        supply((b"CURR 25;:SYST:ERR?\n", b'-222,"Data out of range"\n')).write_set_point(25.0, soon())


@pytest.mark.parametrize(("is_on", "command"), [(True, b"OUTP ON"), (False, b"OUTP OFF")])
def test_the_output_is_switched(is_on, command):
    supply((command + b";:SYST:ERR?\n", OK)).switch_output(is_on, soon())


@pytest.mark.parametrize(("answer", "is_on"), [(b"1", True), (b"0", False), (b"ON", True), (b"OFF", False)])
def test_the_state_of_the_output_is_read(answer, is_on):
    assert supply((b"OUTP?;:SYST:ERR?\n", answer + b";" + OK)).is_output_on(soon()) is is_on


def test_a_state_that_makes_no_sense_is_a_fault():
    with pytest.raises(DeviceFault, match="must say whether its output is on; received '2'"):
        supply((b"OUTP?;:SYST:ERR?\n", b"2;" + OK)).is_output_on(soon())


@pytest.mark.parametrize(("voltage", "is_regulating"), [(b"12.0", True), (b"19.7", False), (b"-19.9", False)])
def test_current_and_voltage_are_measured_together(voltage, is_regulating):
    answer = b"\x13+1.499E+00;" + voltage + b";" + KEPCO_OK
    measured = supply((b"MEAS:CURR?;:MEAS:VOLT?;:SYST:ERR?\n", answer), dialect=KEPCO_BOP).measure(soon())
    assert (measured.current_A, measured.is_regulating) == (1.499, is_regulating)


def test_it_identifies_itself_even_with_a_semicolon():
    assert supply((b"*IDN?\n", b"\x13KEPCO,BOP;2.1\x11\r\n")).identify(soon()) == "KEPCO,BOP;2.1"


def test_an_answer_without_its_error_state_is_a_fault():
    with pytest.raises(DeviceFault, match="must give 1 answers and its error state"):
        supply((b"CURR?;:SYST:ERR?\n", b"1.5\n")).read_set_point_A(soon())


def test_a_line_longer_than_a_kepco_takes_is_never_sent():
    with pytest.raises(DeviceFault, match="at most 127 bytes"):
        encode_line("MEAS:CURR?;:" * 10, KEPCO_BOP)


def test_no_command_can_swing_a_kepco_or_reset_a_supply():
    for dialect in (GENERIC, KEPCO_BOP):
        assert not any(
            word in command for command in dialect.preparation for word in ("DIAG", "*RST", "*TST")
        )


def test_a_late_answer_about_the_output_is_not_taken_for_a_current():
    port = ScriptedPort(
        [(0.6, b'1;0,"No error"\n')],
        [(0.7, b"KEPCO,BOP 50-20M,A12345,2.1\n")],
        [(0, b'-1.500E+00;0,"No error"\n')],
    )
    late = ScpiSupply(port, lowest_A=-5.0, highest_A=5.0, compliance_V=20.0, resolution_A=1e-3)
    with pytest.raises(DeadlineExceeded):
        late.is_output_on(Deadline.after(0.1))
    assert late.read_set_point_A(Deadline.after(10.0)) == -1.5
