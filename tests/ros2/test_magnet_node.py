"""The ROS 2 node, with stand-ins for rclpy and the message types that it uses: ROS 2 is not at hand where the tests run."""

from __future__ import annotations

import sys
import tomllib
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest
import torch

from estimator.calibration.result import Calibration
from estimator.rig_files.read import rig_from_text
from tests.estimator.export.conftest import calibration_of

PACKAGE = Path(__file__).parents[2] / "ros2/coilcal_ros"
RIG = """
schema_version: 1
name: two coils, an arm and a stage
movers: {arm: {motion: UR3e}, stage: {motion: displacement}}
coils:
  carried: {carried_by: arm, radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3}
  shifted: {carried_by: stage, radius_mm: 40, wire_radius_mm: 0.5, axial_loops: 5, radial_loops: 3, world_from_coil0: {z_mm: -50}}
sensors: {hall: {noise_uT: 20}}
"""
POINT_M = [0.0, 0.0, 0.01]
JOINTS_RAD = [0.1, -1.5, -1.4, 0.2, 1.5, 0.3]


def record(**defaults: Any) -> type:
    """A message type: fields with defaults, set by keyword."""

    def fill(self: Any, **given: Any) -> None:
        unknown = set(given) - set(defaults)
        assert not unknown, unknown
        for name, value in defaults.items():
            setattr(self, name, given.get(name, value() if callable(value) else value))

    return type("Message", (), {"__init__": fill, "__slots__": tuple(defaults)})


Header = record(stamp=None, frame_id="")
Vector3 = record(x=0.0, y=0.0, z=0.0)
Quaternion = record(x=0.0, y=0.0, z=0.0, w=1.0)
Pose = record(position=Vector3, orientation=Quaternion)
MESSAGES = {  # fields as in the .msg files of common_interfaces
    "geometry_msgs.msg": {
        "PointStamped": record(header=Header, point=Vector3),
        "PoseStamped": record(header=Header, pose=Pose),
        "Vector3Stamped": record(header=Header, vector=Vector3),
    },
    "sensor_msgs.msg": {
        "JointState": record(header=Header, name=list, position=list, velocity=list, effort=list),
        "MagneticField": record(
            header=Header, magnetic_field=Vector3, magnetic_field_covariance=lambda: [0.0] * 9
        ),
    },
    "std_msgs.msg": {"Float64MultiArray": record(layout=None, data=list)},
    "std_srvs.srv": {
        "Trigger": SimpleNamespace(Request=record(), Response=record(success=False, message=""))
    },
}


class Node:
    """What `rclpy.node.Node` offers of what the node calls."""

    given: ClassVar[dict[str, Any]] = {}

    def __init__(self, name: str) -> None:
        self.name, self.sent, self.heard, self.served, self.logged = name, {}, {}, {}, []

    def declare_parameter(self, name: str, default: Any) -> SimpleNamespace:
        return SimpleNamespace(value=self.given.get(name, default))

    def create_publisher(self, kind: type, topic: str, depth: int) -> SimpleNamespace:
        def publish(message: Any) -> None:
            assert isinstance(message, kind)
            self.sent.setdefault(topic, []).append(message)

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind: type, topic: str, call: Callable[[Any], None], depth: int) -> None:
        self.heard[topic] = (kind, call)

    def create_service(self, kind: Any, name: str, call: Callable[[Any, Any], Any]) -> None:
        self.served[name] = lambda: call(kind.Request(), kind.Response())

    def get_logger(self) -> SimpleNamespace:
        return SimpleNamespace(info=self.logged.append, warning=self.logged.append)

    def get_clock(self) -> SimpleNamespace:
        return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))


@pytest.fixture
def node(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The node with a calibration of the rig, and a way to send it messages."""
    calibration = calibration_of(rig_from_text(RIG))
    loaded = {"calibration": calibration}
    monkeypatch.setattr(Calibration, "load", classmethod(lambda cls, folder: loaded[str(folder)]))
    rclpy = ModuleType("rclpy")
    rclpy_node = ModuleType("rclpy.node")
    rclpy_node.Node = Node  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "rclpy", rclpy)
    monkeypatch.setitem(sys.modules, "rclpy.node", rclpy_node)
    for name, types in MESSAGES.items():
        module = ModuleType(name)
        vars(module).update(types)
        monkeypatch.setitem(sys.modules, name.partition(".")[0], ModuleType(name.partition(".")[0]))
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(PACKAGE))
    monkeypatch.setattr(Node, "given", {"joint_names.arm": list("abcdef"), "most_A": 4.0})
    from coilcal_ros.node import MagnetNode

    made = MagnetNode()
    made.loaded, made.calibration = loaded, calibration
    yield made
    for name in [name for name in sys.modules if name.startswith("coilcal_ros")]:
        del sys.modules[name]


def tell(node: Any, topic: str, **fields: Any) -> None:
    kind, call = node.heard[topic]
    call(kind(**fields))


def field_sent(node: Any) -> list[float]:
    vector = node.sent["field"][-1].magnetic_field
    return [vector.x, vector.y, vector.z]


def settled(node: Any) -> dict[str, torch.Tensor]:
    """Arm and stage in place, with a point; returns their motions."""
    tell(node, "joint_states", name=["other", *"fedcba"], position=[9.0, *reversed(JOINTS_RAD)])
    quarter = Quaternion(x=0.0, y=0.0, z=0.5**0.5, w=0.5**0.5)
    tell(node, "stage/pose", pose=Pose(position=Vector3(x=0.01, y=0.0, z=0.002), orientation=quarter))
    tell(node, "point", point=Vector3(x=POINT_M[0], y=POINT_M[1], z=POINT_M[2]))
    stage = [0.01, 0.0, 0.002, 0.0, 0.0, torch.pi / 2.0]
    return {name: torch.tensor(row).double() for name, row in (("arm", JOINTS_RAD), ("stage", stage))}


def test_field_at_a_point_follows_currents_joints_and_poses(node):
    motion = settled(node)
    tell(node, "currents", data=[2.0, -1.0])
    points_m = torch.tensor([POINT_M], dtype=torch.float64)
    expected_T = node.calibration.field(points_m, {"carried": 2.0, "shifted": -1.0}, motion)[0]
    assert field_sent(node) == pytest.approx(expected_T.tolist(), rel=1e-9)
    assert node.sent["field"][-1].header.frame_id == "world"
    assert node.logged[0] == "currents in the order carried, shifted"


def test_wanted_field_gives_currents_that_make_it(node):
    motion = settled(node)
    points_m = torch.tensor([POINT_M], dtype=torch.float64)
    wanted_T = node.calibration.field(points_m, {"carried": 1.5, "shifted": 0.5}, motion)[0].tolist()
    tell(node, "wanted_field", vector=Vector3(x=wanted_T[0], y=wanted_T[1], z=wanted_T[2]))
    assert node.sent["wanted_currents"][-1].data == pytest.approx([1.5, 0.5], rel=1e-4)  # the arm is far away
    tell(node, "wanted_field", vector=Vector3(x=0.0, y=0.0, z=1.0))
    assert max(map(abs, node.sent["wanted_currents"][-1].data)) <= 4.0 + 1e-9


def test_reload_takes_a_new_calibration_and_refuses_that_of_other_coils(node):
    settled(node)
    tell(node, "currents", data=[0.0, 1.0])
    before_T = field_sent(node)
    node.loaded["calibration"] = calibration_of(rig_from_text(RIG.replace("radius_mm: 40", "radius_mm: 41")))
    answer = node.served["reload"]()
    assert (answer.success, answer.message) == (True, "calibration in use")
    assert field_sent(node) != before_T
    node.loaded["calibration"] = calibration_of(rig_from_text(RIG.replace("  shifted", "  another")))
    answer = node.served["reload"]()
    assert not answer.success
    assert (
        "must have the same coils and movers (carried, shifted, arm, stage); received carried, another"
        in answer.message
    )
    tell(node, "currents", data=[0.0, 1.0])  # the one in use stays


def test_what_cannot_be_computed_is_logged_and_nothing_is_sent(node):
    tell(node, "point", header=Header(frame_id="map"), point=Vector3())
    tell(node, "wanted_field", vector=Vector3())  # no point yet
    assert node.sent == {}
    tell(node, "point", point=Vector3())
    assert "arm" in node.logged[-1]  # no joints of it yet
    settled(node)
    sent = len(node.sent["field"])
    tell(node, "currents", data=[1.0])
    assert node.logged[-1] == "currents must be one for each of carried, shifted; received 1"
    assert len(node.sent["field"]) == sent


def test_package_names_what_the_node_imports_and_the_version_of_coilcal():
    package = ET.parse(PACKAGE / "package.xml").getroot()
    version = tomllib.loads((PACKAGE.parents[1] / "pyproject.toml").read_text())["project"]["version"]
    assert package.findtext("version") == version
    needed = {element.text for element in package.iter("exec_depend")}
    assert needed == {"rclpy", *(name.partition(".")[0] for name in MESSAGES)}
