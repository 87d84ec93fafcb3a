"""The MuJoCo robot against a model compiled and stepped here by hand."""

import mujoco
import numpy as np
import pytest
from deploy import RobotError, load_bundle
from deploy.interfaces import JointCommand, RobotInterface, Simulated
from deploy.robots.mujoco_robot import MujocoRobot


@pytest.fixture
def bundle(bundle_dir):
    return load_bundle(bundle_dir)


def by_hand(bundle):
    """The same start, from the scene file and the manifest."""
    model = mujoco.MjModel.from_xml_path(str(bundle.root / "scene.xml"))
    data = mujoco.MjData(model)
    data.qpos[:7] = [0, 0, bundle.start_height, 1, 0, 0, 0]
    for joint in bundle.joints:
        data.joint(joint.name).qpos[0] = joint.stance
        data.actuator(joint.actuator).ctrl[0] = joint.target_offset
    return model, data


def command(bundle, **changes):
    """A command that holds the stance as the scene's own servos do."""
    values = {
        "q": bundle.per_joint("target_offset"),
        "dq": np.zeros(12),
        "kp": bundle.per_joint("kp"),
        "kd": bundle.per_joint("kd"),
        "tau": np.zeros(12),
    }
    return JointCommand(**{**values, **changes}, stamp_ns=0)


def test_is_a_robot(bundle):
    robot: RobotInterface = MujocoRobot(bundle)
    assert isinstance(robot, Simulated)
    assert robot.read_depth() is None


def test_steps_as_the_scene_alone_does(bundle):
    model, data = by_hand(bundle)
    robot = MujocoRobot(bundle, joint_noise=0.0)
    target = bundle.per_joint("target_offset") + 0.1
    data.ctrl[:] = target
    robot.write(command(bundle, q=target))
    mujoco.mj_step(model, data, nstep=40)
    robot.sleep_until(200_000_000)
    np.testing.assert_allclose(robot.read().q, data.qpos[7:], atol=1e-9)
    np.testing.assert_allclose(robot.truth().position, data.qpos[:3], atol=1e-9)


def test_servo_law_acts_at_every_physics_step(bundle):
    """Full law with feed-forward and velocity target, against torques set by hand at each 5 ms step."""
    rng = np.random.default_rng(0)
    sent = command(bundle, dq=rng.normal(size=12), kp=rng.uniform(20, 60, 12), tau=rng.normal(size=12))
    robot = MujocoRobot(bundle, joint_noise=0.0)
    robot.write(sent)
    torques = []
    for step in range(1, 9):
        state = robot.read()
        law = sent.kp * (sent.q - state.q) + sent.kd * (sent.dq - state.dq) + sent.tau
        torques.append((robot.read().tau, np.clip(law, -30, 30)))
        robot.sleep_until(step * 5_000_000)
    for measured, law in torques[1:]:  # the first reading still shows the command of the start
        np.testing.assert_allclose(measured, law, atol=1e-9)
    assert np.ptp([law for _, law in torques], axis=0).max() > 0.1


def test_torque_is_limited(bundle):
    robot = MujocoRobot(bundle, joint_noise=0.0)
    robot.write(command(bundle, q=bundle.per_joint("target_offset") + 2.0))
    robot.sleep_until(5_000_000)
    assert np.abs(robot.read().tau).max() == 30.0


def test_energy_is_summed_over_physics_steps(bundle):
    model, data = by_hand(bundle)
    robot = MujocoRobot(bundle, joint_noise=0.0)
    target = bundle.per_joint("target_offset") + 0.3 * np.tile([1, -1], 6)
    robot.write(command(bundle, q=target))
    data.ctrl[:] = target
    energy = peak = 0.0
    for _ in range(40):
        before = data.qvel[6:].copy()
        mujoco.mj_step(model, data)
        power = sum(max(w * t, 0.0) for w, t in zip(before, data.actuator_force, strict=True))
        energy, peak = energy + power * 0.005, max(peak, power)
    robot.sleep_until(200_000_000)
    reading = robot.energy()
    assert reading.joint_energy_pos_j.sum() == pytest.approx(energy, rel=1e-9)
    assert reading.peak_pos_w == pytest.approx(peak, rel=1e-9)
    assert energy > 1.0
    assert robot.energy().peak_pos_w == 0.0


def test_ideal_imu_agrees_with_mujoco_sensors(bundle):
    xml = (bundle.root / "scene.xml").read_text()
    xml = xml.replace("<freejoint/>", '<freejoint/><site name="imu"/>').replace(
        "</mujoco>",
        '<sensor><gyro site="imu"/><accelerometer site="imu"/><framequat objtype="body" objname="base"/></sensor>'
        "</mujoco>",
    )
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    _, start = by_hand(bundle)
    data.qpos[:], data.ctrl[:] = start.qpos, start.ctrl
    robot = MujocoRobot(bundle, joint_noise=0.0)
    target = bundle.per_joint("target_offset") + np.repeat([0.2, -0.1, 0.1, -0.2], 3)
    data.ctrl[:] = target
    robot.write(command(bundle, q=target))
    mujoco.mj_step(model, data, nstep=12)
    mujoco.mj_forward(model, data)
    robot.sleep_until(60_000_000)
    state = robot.read()
    np.testing.assert_allclose(state.gyro, data.sensordata[:3], atol=1e-8)
    np.testing.assert_allclose(state.acc, data.sensordata[3:6], atol=1e-6)
    np.testing.assert_allclose(state.quat_wxyz, data.sensordata[6:], atol=1e-9)
    assert np.abs(state.gyro).max() > 0.01


def test_clock_is_virtual_and_exact(bundle):
    robot = MujocoRobot(bundle)
    for tick in range(1, 101):
        robot.sleep_until(tick * 20_000_000)
        assert robot.now_ns() == tick * 20_000_000
    robot.sleep_until(0)
    assert robot.now_ns() == 2_000_000_000


def test_holds_its_stance(bundle):
    robot = MujocoRobot(bundle)
    robot.sleep_until(2_000_000_000)
    assert robot.truth().position[2] == pytest.approx(bundle.start_height, abs=0.02)
    assert np.abs(robot.read().dq).max() < 0.05


def test_damping_lets_it_sink_slowly(bundle):
    robot = MujocoRobot(bundle)
    robot.damp()
    speeds = []
    for tick in range(1, 101):
        robot.sleep_until(tick * 20_000_000)
        speeds.append(-robot.truth().velocity[2])
    assert robot.truth().position[2] < 0.5 * bundle.start_height
    assert max(speeds) < np.sqrt(2 * 9.81 * bundle.start_height) / 2  # well below free fall


def test_seed_decides_the_start(bundle):
    starts = [MujocoRobot(bundle, seed=seed).read().q for seed in (0, 0, 1)]
    np.testing.assert_array_equal(starts[0], starts[1])
    assert 0 < np.abs(starts[0] - starts[2]).max() <= 0.04


def test_reading_changes_nothing(bundle):
    positions = []
    for reads in (1, 5):
        robot = MujocoRobot(bundle)
        for tick in range(1, 21):
            for _ in range(reads):
                robot.read(), robot.truth()
            robot.sleep_until(tick * 20_000_000)
        positions.append(robot.truth().position)
    np.testing.assert_array_equal(*positions)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name="base"', 'name="trunk"', "no body 'base'"),
        ('name="FR_foot"', 'name="FR_toe"', "no site 'FR_foot'"),
        ('<position name="RL_calf_joint"', '<position name="other"', "no actuator 'RL_calf_joint'"),
        ("<freejoint/>", "", "no free joint"),
        ('mass="12"', 'mass="13"', "total mass is 15, the manifest says 14"),
        ('forcerange="-30.0 30.0"', 'forcerange="-20 20"', "torque limit of FL_hip_joint is 20"),
        ('forcerange="-30.0 30.0"', "", "torque limit of FL_hip_joint is inf"),
        ('timestep="0.005"', 'timestep="0.004"', "physics step"),
        ('<position name="FL_hip_joint"', '<position gear="2" name="FL_hip_joint"', "not a position servo"),
        ("<worldbody>", "<worldbody><nonsense/>", "MuJoCo cannot compile"),
        ("<worldbody>", '<include file="../other.xml"/><worldbody>', "<include file='../other.xml'> reaches outside"),
        ("<worldbody>", '<asset><mesh file="/leg.stl"/></asset><worldbody>', "<mesh file='/leg.stl'> reaches outside"),
        ("<worldbody>", '<compiler meshdir="."/><worldbody>', "<compiler meshdir='.'> reaches outside"),
        ("</mujoco>", "", "not valid XML"),
    ],
)
def test_scene_of_another_robot_is_refused(folder, old, new, words):
    scene = folder.files["scene.xml"].decode()
    assert old in scene
    folder.files["scene.xml"] = scene.replace(old, new).encode()
    with pytest.raises(RobotError, match=words):
        MujocoRobot(load_bundle(folder.seal()))
