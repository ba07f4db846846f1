"""The node `magnet`: topics and a service about a `LiveMagnet`. Frames are told by names, units are SI, as ROS has them."""

from __future__ import annotations

import math

import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3Stamped
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import JointState, MagneticField
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from coilcal_ros.live_magnet import LiveMagnet
from estimator import InvalidInput

DEPTH = 10  # messages that wait in a queue


class MagnetNode(Node):
    """Publishes `field` and `wanted_currents`.

    Subscribes to `currents` (ampere, in the order of the coils, which is logged at the start), `point`, `wanted_field` (tesla, at the last
    point), to `joint_states` for arms with joint angles, and to `<mover>/pose` for other movers. `reload` reads the calibrations
    again.
    """

    def __init__(self) -> None:
        super().__init__("magnet")
        folders = list(self.declare_parameter("calibrations", ["calibration"]).value)
        most_A = float(self.declare_parameter("most_A", 0.0).value)  # 0 sets no bound
        self._frame = str(self.declare_parameter("frame_id", "world").value)
        self._magnet = LiveMagnet(folders, most_A or None)
        self._point_m: list[float] | None = None
        self._currents_A = [0.0] * len(self._magnet.coils)
        self._joints: dict[str, list[str]] = {}
        self._field = self.create_publisher(MagneticField, "field", DEPTH)
        self._wanted = self.create_publisher(Float64MultiArray, "wanted_currents", DEPTH)
        self.create_subscription(Float64MultiArray, "currents", self._on_currents, DEPTH)
        self.create_subscription(PointStamped, "point", self._on_point, DEPTH)
        self.create_subscription(Vector3Stamped, "wanted_field", self._on_wanted_field, DEPTH)
        for name, mover in self._magnet.movers.items():
            if mover.table is None:
                self.create_subscription(PoseStamped, f"{name}/pose", self._mover_of(name), DEPTH)
            else:
                names = [f"{name}_joint_{number}" for number in range(6)]
                self._joints[name] = list(self.declare_parameter(f"joint_names.{name}", names).value)
        if self._joints:
            self.create_subscription(JointState, "joint_states", self._on_joints, DEPTH)
        self.create_service(Trigger, "reload", self._on_reload)
        self.get_logger().info(f"currents in the order {', '.join(self._magnet.coils)}")

    def _on_currents(self, message: Float64MultiArray) -> None:
        self._currents_A = list(message.data)
        self._publish_field()

    def _on_point(self, message: PointStamped) -> None:
        if self._is_ours(message.header.frame_id):
            self._point_m = [message.point.x, message.point.y, message.point.z]
            self._publish_field()

    def _on_joints(self, message: JointState) -> None:
        angles_rad = dict(zip(message.name, message.position, strict=False))
        for mover, names in self._joints.items():
            if all(name in angles_rad for name in names):  # other arms share the topic
                self._magnet.move(mover, [angles_rad[name] for name in names])
        self._publish_field()

    def _mover_of(self, name: str):  # type: ignore[no-untyped-def]
        def on_pose(message: PoseStamped) -> None:
            at, turn = message.pose.position, message.pose.orientation
            vector_rad = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_rotvec()
            self._magnet.move(name, [at.x, at.y, at.z, *vector_rad.tolist()])
            self._publish_field()

        return on_pose

    def _on_wanted_field(self, message: Vector3Stamped) -> None:
        if self._point_m is None or not self._is_ours(message.header.frame_id):
            return
        wanted_T = [message.vector.x, message.vector.y, message.vector.z]
        try:
            currents_A = self._magnet.currents_A(self._point_m, wanted_T)
        except InvalidInput as error:
            self.get_logger().warning(str(error))
            return
        if all(map(math.isfinite, currents_A)):
            self._wanted.publish(Float64MultiArray(data=currents_A))
        else:
            self.get_logger().warning("no currents: the point lies inside a winding")

    def _publish_field(self) -> None:
        if self._point_m is None:
            return
        try:
            field_T = self._magnet.field_T(self._point_m, self._currents_A)
        except InvalidInput as error:
            self.get_logger().warning(str(error))
            return
        message = MagneticField()  # its covariance stays 0, which sensor_msgs reads as unknown
        message.header.stamp = self.get_clock().now().to_msg()
        message.header.frame_id = self._frame
        message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = field_T
        self._field.publish(message)

    def _on_reload(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message, response.success = self._magnet.reload(), True
        except (InvalidInput, OSError) as error:
            response.message, response.success = str(error), False
        self._publish_field()
        return response

    def _is_ours(self, frame: str) -> bool:
        if frame in ("", self._frame):
            return True
        self.get_logger().warning(f"points must be in the frame {self._frame}; received {frame!r}")
        return False


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = MagnetNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
