"""ROS 2: messages against the definitions of rosbags, the robot against a stand-in for rclpy."""

import subprocess
import sys
import threading
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from deploy.bundles.loading import load_bundle
from deploy.control.clock import WallClock
from deploy.depth.ros2 import Ros2Depth, Ros2DepthConfig
from deploy.errors import RobotError
from deploy.interfaces import Intrinsics, JointCommand, RobotSpec
from deploy.robots.opening import Connection, open_robot
from deploy.robots.ros2.messages import depth_image, fill_servo, intrinsics, joint_arrays, robot_state
from deploy.robots.ros2.robot import Ros2Config, Ros2Robot
from deploy.robots.specs import GO2, ROBOTS, mismatches
from ros2_stand_in import empty, install, over_the_wire

NAMES = ("hip", "thigh", "calf")


def joint_state(now_ns=1_500_000_002):
    """Joints in another order, and one that nobody asked for."""
    message = empty("sensor_msgs/msg/JointState")
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
    message.name = ["calf", "gripper", "hip", "thigh"]
    message.position, message.velocity = np.array([3.0, 9.0, 1.0, 2.0]), np.array([0.3, 9.0, 0.1, 0.2])
    message.effort = np.array([30.0, 9.0, 10.0, 20.0])
    return message


def imu(now_ns=1_500_000_001):
    message = empty("sensor_msgs/msg/Imu")
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 1_000_000_000)
    for field, names, values in (
        (message.orientation, "wxyz", (0.1, 0.7, 0.5, 0.5)),
        (message.angular_velocity, "xyz", (1.0, 2.0, 3.0)),
        (message.linear_acceleration, "xyz", (4.0, 5.0, 6.0)),
    ):
        for name, value in zip(names, values, strict=True):
            setattr(field, name, value)
    return message


def camera_info():
    message = empty("sensor_msgs/msg/CameraInfo")
    message.k = np.array([425.0, 0.0, 420.0, 0.0, 426.0, 240.0, 0.0, 0.0, 1.0])
    return message


def image(encoding="16UC1", data=(0, 1500, 65535, 1, 2, 3), big=False, padding=0):
    message = empty("sensor_msgs/msg/Image")
    dtype = np.dtype((">" if big else "<") + ("f4" if encoding == "32FC1" else "u2"))
    rows = np.array(data, dtype).reshape(2, 3).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=7)
    message.encoding, message.is_bigendian, message.height, message.width = encoding, int(big), 2, 3
    message.step, message.data = rows.shape[1], rows.reshape(-1)
    message.header.stamp.sec, message.header.stamp.nanosec = 2, 3
    return message


def test_a_reading_is_bound_by_name_and_as_old_as_its_older_half():
    state = robot_state(over_the_wire(joint_state()), over_the_wire(imu()), NAMES, ("/j", "/i"), seq=4)
    assert (state.stamp_ns, state.seq) == (1_500_000_001, 4)
    np.testing.assert_array_equal(state.q, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(state.dq, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(state.tau, [10.0, 20.0, 30.0])
    np.testing.assert_array_equal(state.quat_wxyz, [0.1, 0.7, 0.5, 0.5])
    np.testing.assert_array_equal(state.gyro, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(state.acc, [4.0, 5.0, 6.0])


def test_missing_joints_values_and_orientation_are_named():
    message = joint_state()
    with pytest.raises(RobotError, match=r"/j: has no joint \['ankle'\], only \['calf', 'gripper'"):
        joint_arrays(message, ("hip", "ankle"), "/j")
    message.effort = np.zeros(0)
    with pytest.raises(RobotError, match="/j: effort has 0 of 4 values; the driver must fill it"):
        joint_arrays(message, NAMES, "/j")
    blind = imu()
    blind.orientation_covariance[0] = -1.0
    with pytest.raises(RobotError, match="/i: gives no orientation"):
        robot_state(joint_state(), blind, NAMES, ("/j", "/i"), 0)


def command(value=1.0):
    rows = [value * np.array([i + 0.1, i + 0.2, i + 0.3]) for i in range(5)]
    return JointCommand(*rows, stamp_ns=0)


def test_a_command_names_its_rows_and_columns(monkeypatch):
    install(monkeypatch)
    from std_msgs.msg import Float64MultiArray, MultiArrayDimension  # type: ignore

    sent = over_the_wire(fill_servo(Float64MultiArray(), MultiArrayDimension, command(), NAMES))
    rows, columns = sent.layout.dim
    assert (rows.label, rows.size, rows.stride) == ("position velocity kp kd effort", 5, 15)
    assert (columns.label, columns.size, columns.stride) == ("hip thigh calf", 3, 3)
    table = dict(zip(rows.label.split(), np.reshape(sent.data, (5, 3)), strict=True))
    np.testing.assert_allclose(table["position"], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(table["velocity"], [1.1, 1.2, 1.3])
    np.testing.assert_allclose(table["kp"], [2.1, 2.2, 2.3])
    np.testing.assert_allclose(table["kd"], [3.1, 3.2, 3.3])
    np.testing.assert_allclose(table["effort"], [4.1, 4.2, 4.3])


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("padding", [0, 6])
def test_depth_in_millimetres(big, padding):
    depths = depth_image(over_the_wire(image(big=big, padding=padding)), "/d")
    np.testing.assert_allclose(depths, [[0.0, 1.5, 65.535], [0.001, 0.002, 0.003]], rtol=1e-6)
    assert depths.dtype == np.float32


def test_depth_in_metres_keeps_what_is_no_number():
    depths = depth_image(image("32FC1", (np.nan, 1.5, np.inf, 0.0, 2.0, 3.0)), "/d")
    np.testing.assert_array_equal(depths, np.array([[np.nan, 1.5, np.inf], [0, 2, 3]], np.float32))


def test_what_is_no_depth_image_is_refused():
    with pytest.raises(RobotError, match="/d: its encoding is 'rgb8'; need a depth image"):
        depth_image(image("rgb8"), "/d")
    torn = image()
    torn.data = torn.data[:-1]
    with pytest.raises(RobotError, match="/d: 11 bytes do not make 2 rows of 6 with 3 pixels each"):
        depth_image(torn, "/d")


def test_intrinsics_count_from_the_corner_of_the_first_pixel():
    assert intrinsics(over_the_wire(camera_info()), "/i") == Intrinsics(425.0, 426.0, 420.5, 240.5)
    raw = camera_info()
    raw.d = np.array([0.1, 0.0])
    with pytest.raises(RobotError, match="/i: the image is distorted"):
        intrinsics(raw, "/i")
    with pytest.raises(RobotError, match="/i: the camera is not calibrated"):
        intrinsics(empty("sensor_msgs/msg/CameraInfo"), "/i")


# ---------------------------------------------------------------------------------------------- with the stand-in


class Driver:
    """What a robot's driver does on the graph."""

    def __init__(self, graph, robot):
        graph.listeners["/joint_servo"] = 1
        self.graph, self.clock = graph, robot.clock

    def state(self):
        now = self.clock.now_ns()
        self.graph.send("/joint_states", joint_state(now))
        self.graph.send("/imu", imu(now))


@pytest.fixture
def graph(monkeypatch):
    """The stand-in, in place of ROS 2."""
    return install(monkeypatch)


@pytest.fixture
def robot(graph):
    """A robot whose driver sends one reading as soon as it is listened to."""
    made = Ros2Robot(RobotSpec("three joints", NAMES), Ros2Config(wait_s=2.0))
    made.driver = Driver(graph, made)
    graph.on_subscription = lambda topic: topic == "/imu" and threading.Timer(0.05, made.driver.state).start()
    yield made
    made.stop()


def test_a_robot_from_start_to_stop(graph, robot):
    robot.damp()  # before the start nothing is sent
    robot.start()
    assert graph.sent.keys() == {"/joint_states", "/imu"}
    first = robot.read()
    np.testing.assert_array_equal(first.q, [1.0, 2.0, 3.0])
    assert 0 <= robot.clock.now_ns() - first.stamp_ns < 1e9
    robot.driver.state()
    assert robot.read().seq == first.seq + 1
    assert robot.read_depth() is None
    robot.write(command())
    robot.damp()
    sent = [np.reshape(message.data, (5, 3)) for message in graph.sent["/joint_servo"]]
    np.testing.assert_allclose(sent[0][0], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sent[1], [[0] * 3, [0] * 3, [0] * 3, [3] * 3, [0] * 3])
    with pytest.raises(RobotError, match="not finite; the robot was damped"):
        robot.write(command(np.nan))
    assert np.reshape(graph.sent["/joint_servo"][-1].data, (5, 3))[3].tolist() == [3.0, 3.0, 3.0]
    robot.stop()
    robot.stop()
    assert not graph.running
    robot.damp()
    assert len(graph.sent["/joint_servo"]) == 3
    for call in (robot.read, lambda: robot.write(command())):
        with pytest.raises(RobotError, match="not started"):
            call()


def test_work_is_counted_message_by_message(graph, robot):
    """10 ms, 30 ms and a broken message; power 2 * 3 + max(-1 * 5, 0) + 4 * 1 = 10 W."""
    robot.start()
    assert robot.energy() is None
    begin = int(robot.read().stamp_ns)
    for after_ms in (10, 40, 50):
        message = joint_state(begin + after_ms * 1_000_000)
        message.velocity, message.effort = np.array([4.0, 9.0, 2.0, -1.0]), np.array([1.0, 9.0, 3.0, 5.0])
        if after_ms == 50:
            message.effort = np.array([])
        graph.send("/joint_states", message)
    found = robot.energy()
    assert found.states == 2
    np.testing.assert_allclose(found.joint_energy_pos_j, [0.24, 0.0, 0.16], rtol=1e-3)
    assert found.peak_pos_w == pytest.approx(10.0)
    assert robot.energy().peak_pos_w == 0.0


def test_another_publisher_is_noticed_and_refused(graph, robot):
    robot.start()
    robot.read()
    graph.publishers["/joint_servo"] += 1
    with pytest.raises(RobotError, match="another node publishes on /joint_servo"):
        robot.read()
    late = Ros2Robot(RobotSpec("late", NAMES), Ros2Config(wait_s=2.0))
    with pytest.raises(RobotError, match="another node publishes on /joint_servo"):
        late.start()
    late.stop()


def test_a_silent_topic_and_a_missing_listener(graph):
    silent = Ros2Robot(RobotSpec("silent", NAMES), Ros2Config(wait_s=0.05))
    with pytest.raises(RobotError, match=r"nothing arrives on /joint_states within 0.05 s; `ros2 topic list`"):
        silent.start()
    silent.stop()


def test_nobody_listens(graph, robot):
    graph.listeners.clear()
    with pytest.raises(RobotError, match="nobody listens to /joint_servo"):
        robot.start()


def test_depth_topics(graph):
    camera = Ros2Depth(Ros2DepthConfig(image="/d", info="/i"))
    camera.start(WallClock())
    assert camera.latest() is None
    graph.send("/d", image())
    assert camera.latest() is None  # not calibrated yet
    graph.send("/i", camera_info())
    frame = camera.latest()
    assert (frame.stamp_ns, frame.seq, frame.intrinsics.cx) == (2_000_000_003, 1, 420.5)
    np.testing.assert_allclose(frame.image_m[0], [0.0, 1.5, 65.535], rtol=1e-6)
    graph.send("/d", image())
    assert camera.latest().seq == 2
    graph.send("/d", image("rgb8"))
    with pytest.raises(RobotError, match="need a depth image"):
        camera.latest()
    camera.stop()
    camera.stop()


def test_depth_topics_have_wall_time(graph, fake_clock):
    fake_clock.virtual = True
    with pytest.raises(RobotError, match="the robot's time is simulated"):
        Ros2Depth().start(fake_clock)


def test_without_ros_the_error_says_what_to_install():
    code = """
import sys
sys.modules["rclpy"] = None
from deploy.errors import RobotError
from deploy.interfaces import RobotSpec
from deploy.robots.ros2.robot import Ros2Config, Ros2Robot
robot = Ros2Robot(RobotSpec("r", ("a",)), Ros2Config())
robot.damp()
robot.stop()
try:
    robot.start()
except RobotError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "'rclpy' cannot be imported; it is no package of pip: install ROS 2" in done.stdout, done.stderr
    assert "source /opt/ros/DISTRO/setup.bash" in done.stdout


# ---------------------------------------------------------------------------------------------- opened by name


def test_robots_are_opened_by_name(bundle_dir, seeing_dir):
    bundle, seeing = load_bundle(bundle_dir), load_bundle(seeing_dir)
    opened = open_robot("ros2", bundle, Connection(ros2=Ros2Config(imu="/imu/data")))
    assert opened.spec == RobotSpec("box over ROS 2", bundle.joint_names)
    with pytest.raises(RobotError, match="no driver for a robot 'lite3'; choose mujoco, go2 or ros2"):
        open_robot("lite3", bundle)
    with pytest.raises(RobotError, match=r"box trot sees: name the robot's depth camera"):
        open_robot("ros2", seeing)
    for camera in ("ros2", "realsense"):
        assert open_robot("ros2", seeing, Connection(depth=camera)).read_depth() is None


def test_a_known_robot_behind_ros2_keeps_its_limits(bundle_dir, monkeypatch):
    bundle = load_bundle(bundle_dir)
    known = replace(GO2, name="box", joint_names=bundle.joint_names[::-1])
    monkeypatch.setitem(cast(dict, ROBOTS), "box", known)
    spec = open_robot("ros2", bundle).spec
    assert spec == replace(known, name="box over ROS 2", feet=None, state_hz=None, command_hz=None)
    assert mismatches(bundle, spec) != []


def test_a_go2_without_cyclonedds_says_what_to_install(bundle_dir, monkeypatch):
    for name in [name for name in sys.modules if name.startswith(("cyclonedds", "deploy.robots.unitree"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "cyclonedds", None)
    with pytest.raises(RobotError, match=r"a Go2 needs cyclonedds .*pip install 'legged-deploy\[unitree\]'"):
        open_robot("go2", load_bundle(bundle_dir))


def test_a_go2_is_opened_without_touching_it(bundle_dir):
    pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'legged-deploy[unitree]'")
    bundle = load_bundle(bundle_dir)
    opened = open_robot("go2", bundle, Connection(interface="nowhere0"))
    assert opened.spec.name == "go2"
