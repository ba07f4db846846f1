"""Simulators end with their parent, share one world, and talk to clients that are independent of this package."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
import textwrap
import time
from functools import partial

import pytest

from drivers.protocols import FlangePose
from drivers.simulated.hall import SimulatedF71
from drivers.simulated.process import Simulator
from drivers.simulated.scpi import short_form
from drivers.simulated.supplies import SimulatedKorad, simulated_kepco, simulated_scpi_supply
from drivers.simulated.thermometers import Simulated224
from drivers.simulated.world import CoilCircuit, World
from tests.drivers.fields import along_z
from tests.drivers.tcp_line import on_tcp


def test_a_simulator_ends_when_its_parent_is_killed():
    program = """
    from functools import partial
    from drivers.simulated.hall import SimulatedF71
    from drivers.simulated.world import CoilCircuit, World
    from tests.drivers.fields import along_z
    from tests.drivers.tcp_line import on_tcp
    import time
    if __name__ == "__main__":
        simulator = on_tcp(partial(SimulatedF71, World([CoilCircuit(2.0, 0.0)]), along_z))
        print(simulator.pid, flush=True)
        time.sleep(60)
    """
    parent = subprocess.Popen([sys.executable, "-c", textwrap.dedent(program)], stdout=subprocess.PIPE)
    pid = int(parent.stdout.readline())
    os.kill(pid, 0)
    parent.send_signal(signal.SIGKILL)
    parent.stdout.close()
    parent.wait()
    end_s = time.monotonic() + 5.0
    with pytest.raises(ProcessLookupError):  # noqa: PT012
        while time.monotonic() < end_s:
            os.kill(pid, 0)
            time.sleep(0.02)


def said_by(client, address):
    """Output of a client, run in its own process with the instrument's address as its first argument."""
    arguments = [sys.executable, "-c", textwrap.dedent(client), address]
    return subprocess.run(arguments, capture_output=True, text=True, timeout=30, check=True).stdout


def test_lake_shores_own_driver_reads_the_simulated_f71(world):
    world.drive(0, 3.0)
    client = """
    import sys
    from lakeshore import Teslameter
    host, _, port = sys.argv[1].rpartition(":")
    meter = Teslameter(ip_address=host, tcp_port=int(port))
    meter.configure_field_measurement_setup(mode="DC", autorange=False, expected_field=0.1, averaging_samples=2)
    points = meter.get_buffered_data_points(0.2, 20)
    print(meter.model_number, meter.get_field_units(), len(points), points[-1].z, meter.get_dc_field_xyz()[3])
    """
    with on_tcp(partial(SimulatedF71, world, along_z)) as simulator:
        output = said_by(client, simulator.address)
    assert output.split() == ["F71", "TESLA", "10", "0.00596", "0.00596"]


def test_lake_shores_own_driver_reads_the_simulated_224(world):
    client = """
    import sys
    from lakeshore import Model224
    host, _, port = sys.argv[1].rpartition(":")
    monitor = Model224(ip_address=host, tcp_port=int(port))
    status = monitor.get_reading_status("D5")
    print(round(monitor.get_kelvin_reading("A")), round(monitor.get_kelvin_reading("C1")), status.sensor_units_over_range)
    """
    world.drive(0, 100.0)
    with on_tcp(partial(Simulated224, world, {"A": 0, "C1": None})) as simulator:
        output = said_by(client, simulator.address)
    coil_K, room_K, is_open = output.split()
    assert float(coil_K) > 296.0
    assert (room_K, is_open) == ("295", "True")


def test_tenmas_driver_reads_the_simulated_korad(world):
    """A Tenma 72-2540 is a KA3005P under another name."""
    client = """
    import sys
    from tenma.tenmaDcLib import Tenma72_2540
    supply = Tenma72_2540(sys.argv[1])
    print(supply.getVersion(), supply.setVoltage(1, 4000), supply.setCurrent(1, 1500))  # both are read back
    supply.ON()
    print(supply.runningCurrent(1), supply.runningVoltage(1), supply.getStatus()["ch1Mode"], supply.getStatus()["outEnabled"])
    supply.setVoltage(1, 2500)
    print(supply.runningCurrent(1), supply.getStatus()["ch1Mode"])
    supply.OFF()
    print(supply.runningCurrent(1), supply.getStatus()["outEnabled"])
    """
    with Simulator.on_serial_line(partial(SimulatedKorad, world, 0)) as simulator:
        lines = said_by(client, simulator.address).splitlines()
    assert lines == ["KORADKA3005PV2.0 4.0 1.5", "1.5 3.0 C.C True", "1.25 C.V", "0.0 False"]


@pytest.mark.parametrize(
    ("make", "name", "current_A"),
    [
        (simulated_kepco, "KEPCO,BOP 50-20M,A12345,2.1", -1.5),
        (simulated_scpi_supply, "COILCAL,SCPI SUPPLY,0,1.0", 1.5),
    ],
)
def test_a_client_of_any_scpi_instrument_sets_and_reads_the_simulated_supplies(make, name, current_A, world):
    """easy-scpi, through pyvisa on a serial line; it has no commands for supplies, so the test takes them from the manual."""
    client = f"""
    import sys
    from easy_scpi import Instrument
    supply = Instrument(port=sys.argv[1], port_match=False, backend="@py", read_termination="\\n", write_termination="\\n")
    supply.connect()
    if {name.startswith("KEPCO")}:
        supply.system.remote(1)
        supply.function.mode("CURR")
    supply.voltage(20)
    supply.current({current_A})
    supply.output("ON")
    questions = (supply.output, supply.current, supply.voltage, supply.measure.current, supply.measure.voltage)
    answers = [supply.id, *(question() for question in questions), supply.system.error()]
    supply.current(6)
    answers += [supply.system.error(), supply.system.error()]
    print("|".join(answer.strip("\\x11\\x13\\r") for answer in answers))
    supply.disconnect()
    """
    with Simulator.on_serial_line(partial(make, world, 0, 5.0)) as simulator:
        answers = said_by(client, simulator.address).strip().split("|")
    assert answers[0] == name
    assert [float(answer) for answer in answers[1:6]] == [1.0, current_A, 20.0, current_A, 2.0 * current_A]
    assert answers[6:] == ['0,"No error"', '-222,"Data out of range"', '0,"No error"']
    assert world.snapshot().currents_A == (current_A,)


def test_a_coil_warms_up_by_its_losses_and_cools_down_again():
    world = World([CoilCircuit(2.0, 0.0, kelvin_per_W=3.0, thermal_time_constant_s=0.2)])
    rises_K = []
    for current_A in (-1.0, 0.0):
        world.drive(0, current_A)
        begin_s = time.monotonic()
        time.sleep(0.2)
        now = world.snapshot()
        rises_K.append(now.coil_temperatures_K[0] - now.room_temperature_K)
        decay = math.exp(-(time.monotonic() - begin_s) / 0.2)
        expected_K = 6.0 * (1.0 - decay) if current_A else rises_K[0] * decay
        assert rises_K[-1] == pytest.approx(expected_K, rel=0.1)


def test_the_current_of_a_coil_follows_its_time_constant():
    world = World([CoilCircuit(resistance_ohm=2.0, inductance_H=0.2)])
    world.drive(0, 1.0)
    begin_s = time.monotonic()
    time.sleep(0.1)
    current_A = world.snapshot().currents_A[0]
    elapsed_s = time.monotonic() - begin_s
    assert current_A == pytest.approx(1 - 2.718281828 ** (-elapsed_s / 0.1), abs=0.02)


def test_a_motion_takes_its_time_and_can_be_halted():
    home = FlangePose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    world = World([CoilCircuit(2.0, 0.0)], [home])
    world.move(0, FlangePose((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 1.0)
    time.sleep(0.2)
    assert world.is_moving(0)
    world.halt(0)
    assert not world.is_moving(0)
    stopped_m = world.snapshot().base_from_flange[0].position_m[0]
    assert 0.15 < stopped_m < 0.5
    time.sleep(0.05)
    assert world.snapshot().base_from_flange[0].position_m[0] == stopped_m


@pytest.mark.parametrize(
    ("long", "short"),
    [("SYSTem:ERRor:ALL?", "SYST:ERR:ALL?"), ("sens:aver:coun", "SENS:AVER:COUN"), ("MODE", "MODE")],
)
def test_long_and_short_forms_are_the_same_command(long, short):
    assert short_form(long) == short_form(short) == short


def test_a_field_that_takes_longer_than_a_sample_is_computed_for_the_points_that_are_read(world):
    computed = []

    def slow(snapshot):
        computed.append(snapshot)
        time.sleep(0.02)  # two samples
        return along_z(snapshot)

    instrument = SimulatedF71(world, slow)
    for _ in range(10):
        time.sleep(0.01)
        instrument.stream()
    assert computed == []
    instrument.take(b"FETC:BUFF:CLE\n")
    time.sleep(0.01)
    instrument.stream()
    assert instrument.take(b"FETC:BUFF:DC?\n").count(b";") == 1
    assert len(computed) == 1
