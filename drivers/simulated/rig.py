"""Simulates all devices of a rig file, so that the rig can be used without hardware."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from drivers.device import ClosesItself
from drivers.errors import Refused
from drivers.limits_section import thermometer_inputs
from drivers.protocols import FlangePose
from drivers.simulated.hall import Simulated460, SimulatedF71, SimulatedSenis, SimulatedTHM1176
from drivers.simulated.instrument import Instrument
from drivers.simulated.process import Simulator
from drivers.simulated.supplies import SimulatedKorad, simulated_kepco, simulated_scpi_supply
from drivers.simulated.thermometers import Simulated224
from drivers.simulated.ur_server import serve_ur
from drivers.simulated.world import CoilCircuit, FieldFunction, World

SENSORS: dict[str, Callable[[World, FieldFunction], Instrument]] = {
    "lakeshore_f71": SimulatedF71,
    "lakeshore_460": Simulated460,
    "senis_3mh6": SimulatedSenis,
    "metrolab_thm1176": SimulatedTHM1176,
}
SUPPLIES: dict[str, Callable[[World, int, Mapping[str, Any]], Callable[[], Instrument]]] = {
    "kepco_bop": lambda world, coil, settings: partial(
        simulated_kepco, world, coil, float(settings["highest_A"])
    ),
    "korad_ka3005p": lambda world, coil, _: partial(SimulatedKorad, world, coil),
    "scpi": lambda world, coil, settings: partial(
        simulated_scpi_supply, world, coil, float(settings["highest_A"])
    ),
}
CB3, E_SERIES = "3.15.4.106291", "5.11.1.108318"
_VERSIONS = {
    **dict.fromkeys(("ur3", "ur5", "ur10"), CB3),
    **dict.fromkeys(("ur3e", "ur5e", "ur10e", "ur16e", "ur20"), E_SERIES),
}
_PORTS = ("serial", "tcp", "visa", "port", "replay", "host", "baud", "record")


class SimulatedRig(ClosesItself):
    """Running simulators of a rig; they end when the `with` block or this process ends.

    Attributes:
        section: The `devices` section with the addresses of the simulators, for `open_devices`.
        simulators: Simulators by the name of the device.
        world: One coil for each supply and one flange for each arm, in the order of the section.
    """

    def __init__(
        self,
        section: Mapping[str, Mapping[str, Any]],
        fields: Mapping[str, FieldFunction],
        *,
        circuits: Sequence[CoilCircuit],
        homes: Sequence[FlangePose],
        first_host: str = "127.20.0.1",
    ) -> None:
        """Start a simulator for each device.

        Args:
            section: The `devices` section of a rig file; its ports are replaced.
            fields: Field at each sensor, by its name; importable, because the simulator's process evaluates it.
            circuits: One for each supply.
            homes: Initial pose of each arm.
            first_host: Address of the first arm; the addresses of the others follow.

        Raises:
            Refused: A device cannot be simulated, a field is missing, or the number of circuits or homes is wrong.
        """
        self.world = World(circuits, homes or [FlangePose((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))])
        self.simulators: dict[str, Simulator] = {}
        self.section: dict[str, dict[str, Any]] = {}
        sources = [name for name, settings in section.items() if "supply" in settings]
        arms = [name for name, settings in section.items() if "arm" in settings]
        if (len(circuits), len(homes)) != (len(sources), len(arms)):
            raise Refused(
                f"a simulated rig must have a circuit for each of {len(sources)} supplies and a home for each of {len(arms)} arms; "
                f"received {len(circuits)} and {len(homes)}"
            )
        try:
            for name, settings in section.items():
                self.section[name] = {key: value for key, value in settings.items() if key not in _PORTS}
                if "arm" in settings:
                    network, _, number = first_host.rpartition(".")
                    host = f"{network}.{int(number) + arms.index(name)}"
                    run = partial(serve_ur, self.world, arms.index(name), _VERSIONS[settings["arm"]], host)
                    self.simulators[name] = Simulator(run)
                else:
                    make = self._instrument(name, settings, fields, sources)
                    self.simulators[name] = Simulator.on_serial_line(make)
            for name, simulator in self.simulators.items():  # they start side by side
                self.section[name]["host" if name in arms else "serial"] = simulator.address
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """End all simulators."""
        for simulator in self.simulators.values():
            simulator.close()

    def _instrument(
        self, name: str, settings: Mapping[str, Any], fields: Mapping[str, FieldFunction], sources: list[str]
    ) -> Callable[[], Instrument]:
        kind = settings.get("sensor") or settings.get("supply") or settings.get("thermometer")
        if kind == "lakeshore_224":
            inputs = thermometer_inputs(settings)
            coils = {
                name: sources.index(target) if target in sources else None for target, name in inputs.items()
            }
            return partial(Simulated224, self.world, coils)
        if kind in SENSORS:
            if name not in fields:
                raise Refused(
                    f"a simulated rig must know the field at {name}; received {', '.join(fields) or 'none'}"
                )
            return partial(_warmed_up, SENSORS[kind], self.world, fields[name])
        if kind in SUPPLIES:
            return SUPPLIES[kind](self.world, sources.index(name), settings)
        raise Refused(f"devices.{name} must be of a kind that can be simulated; received {kind!r}")


def _warmed_up(
    make: Callable[[World, FieldFunction], Instrument], world: World, field: FieldFunction
) -> Instrument:
    """A sensor that answers at once: the first field of a current loads code for half a second of a processor.

    On a busy computer that is longer than an instrument may be silent, so it is done before the simulator says that it listens.
    """
    field(replace(world.snapshot(), currents_A=(1.0,) * len(world.circuits)))
    return make(world, field)
