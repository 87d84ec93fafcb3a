"""Where two packages meet: file formats, protocols, and one robot that must be the same on both sides."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import deploy
import distill
import mujoco
import numpy as np
import pytest
import torch
from deploy.interfaces import JointCommand, RobotState
from deploy.policy.observation import ObservationBuilder
from deploy.robots.mujoco_robot import MujocoRobot
from locorl import LeggedEnv, Policy, TaskConfig, no_randomisation, sample_designs
from locorl.bodies.family import BodyFamily
from morphgen import BodyFactory, GainRule, load_robot

from legged_codesign.bundle import bundle_spec

PACKAGES = ("morphgen", "locorl", "codesign_bo", "distill", "deploy")
ROOT = Path(__file__).parents[2]
STEPS = 50


@pytest.fixture(scope="module")
def bundle(go2: BodyFactory, untrained: Policy, design: np.ndarray, tmp_path_factory) -> deploy.Bundle:
    """A student that never learnt anything, exported for one body as the pipeline does it."""
    student = distill.build_student(untrained.card.dims["proprio"], untrained, distill.StudentConfig())
    folder = tmp_path_factory.mktemp("contracts") / "bundle"
    distill.export_bundle(folder, student, bundle_spec(go2, untrained, design, {}))
    return deploy.load_bundle(folder)


@pytest.fixture(scope="module")
def scene(bundle: deploy.Bundle) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(bundle.path(bundle.robot.scene)))


def task() -> TaskConfig:
    return TaskConfig(randomisation=no_randomisation())


def trained_model(env: LeggedEnv) -> mujoco.MjModel:
    """The model that the environment simulates for its first robot, as one model of its own."""
    model = env.sim.model.__copy__()
    for name, values in env.sim.fields.items():
        getattr(model, name)[...] = values[0]
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


# ---------------------------------------------------------------- the house


def test_bundle_schema_is_one() -> None:
    """deploy's is the source, distill carries a copy."""
    source, carried = (files(name).joinpath("bundle.schema.json").read_bytes() for name in ("deploy", "distill"))
    assert source == carried


def imports(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.lineno, node.module or ""


@pytest.mark.parametrize("package", PACKAGES)
def test_no_package_imports_a_sibling(package: str) -> None:
    """Neither its source nor its tests."""
    siblings = {*PACKAGES, "legged_codesign"} - {package}
    modules = [
        path
        for folder in (ROOT / "packages" / package / "src", ROOT / "tests" / package)
        for path in folder.rglob("*.py")
    ]
    assert len(modules) > 10
    found = [
        f"{path.relative_to(ROOT)}:{line} imports {name}"
        for path in modules
        for line, name in imports(path)
        if name.split(".")[0] in siblings
    ]
    assert not found


# ---------------------------------------------------------------- bodies and control


def test_go2_satisfies_locorl(go2: BodyFactory) -> None:
    designs = sample_designs(go2, 4, np.random.default_rng(1))
    env = LeggedEnv(go2, designs, TaskConfig(), seed=1)
    obs = env.reset()
    generator = torch.Generator().manual_seed(1)
    for _ in range(25):
        obs, reward, terminated, _, info = env.step(0.3 * torch.randn(4, 12, generator=generator))
        assert not info.diverged.any()
        assert reward.isfinite().all()
    assert {group: tuple(values.shape) for group, values in obs.items()} == {
        "proprio": (4, 45),
        "explicit": (4, 3),
        "implicit": (4, 11),
    }
    assert all(values.isfinite().all() for values in obs.values())
    assert env.weight.numpy() == pytest.approx(9.81 * go2.batch(designs).total_mass, rel=1e-6)
    assert len(set(env.weight.tolist())) == 4


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"rule": "stretch"}, "scaling: paper in its training, stretch here"),
        ({"gains": GainRule("mass")}, "gains: none in its training, mass here"),
        (
            {"gains": GainRule("polynomial", (2.0,) + (0.0,) * 14)},
            r"polynomial \(2\.0, .*; kp: 40 .* 80 here; kd: 0\.7 .* 1\.4 h",
        ),
    ],
)
def test_a_policy_knows_rules_and_gains_of_morphgens_bodies(untrained: Policy, options: dict, words: str) -> None:
    assert untrained.card.family == BodyFamily({"scaling": "paper", "gains": "none"}, (40.0,) * 12, (0.7,) * 12)
    untrained.check_bodies(load_robot("go2"))
    with pytest.raises(ValueError, match=words):
        untrained.check_bodies(load_robot("go2", **options))


# ---------------------------------------------------------------- the bundle against the environment


def test_observation_is_the_same(go2: BodyFactory, design: np.ndarray, bundle: deploy.Bundle) -> None:
    """What deploy feeds to the network is what the environment trained it on, in 20 random states."""
    rng = np.random.default_rng(7)
    n = 20
    env = LeggedEnv(go2, np.tile(design, (n, 1)), task())
    env.reset(seed=0)
    quat = rng.normal(size=(n, 4))
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    lower, upper = bundle.per_joint("lower"), bundle.per_joint("upper")
    qpos = np.hstack([rng.normal(size=(n, 3)), quat, rng.uniform(lower, upper, (n, 12))])
    qvel = rng.normal(size=(n, 18)) * np.array([1.0] * 6 + [8.0] * 12)
    env.sim.set_state(torch.arange(n), torch.from_numpy(qpos), torch.from_numpy(qvel))
    env.command[:] = torch.from_numpy(rng.uniform(-1, 1, (n, 3)))
    env.action[:] = torch.from_numpy(rng.normal(size=(n, 12)))
    proprio = env.observe()["proprio"].numpy()

    builder = ObservationBuilder(bundle)
    assert proprio.shape[1] == bundle.observation_size
    for i in range(n):
        state = RobotState(
            stamp_ns=0,
            seq=i,
            q=qpos[i, 7:],
            dq=qvel[i, 6:],
            tau=np.zeros(12),
            quat_wxyz=quat[i],
            gyro=qvel[i, 3:6],  # MuJoCo keeps the rate of a free joint in the body's frame
            acc=np.zeros(3),
        )
        built = builder.build(state, env.command[i].double().numpy(), env.action[i].double().numpy())
        np.testing.assert_allclose(built, proprio[i], atol=1e-5)


def test_bundle_scene_is_the_trained_body(
    go2: BodyFactory, design: np.ndarray, bundle: deploy.Bundle, scene: mujoco.MjModel
) -> None:
    env = LeggedEnv(go2, design[None], task())
    trained = trained_model(env)
    assert scene.opt.timestep == trained.opt.timestep == bundle.physics_dt
    assert bundle.policy_hz == pytest.approx(1.0 / env.dt)
    for name in ("integrator", "solver", "cone", "jacobian", "iterations", "ls_iterations"):
        assert getattr(scene.opt, name) == getattr(trained.opt, name), name
    for name in (
        "actuator_gainprm",
        "actuator_biasprm",
        "actuator_forcerange",
        "jnt_range",
        "dof_armature",
        "dof_damping",
        "dof_frictionloss",
        "geom_friction",
        "geom_size",
        "geom_solref",
        "geom_solimp",
    ):
        np.testing.assert_allclose(getattr(scene, name), getattr(trained, name), rtol=1e-9, atol=1e-12, err_msg=name)

    def mass_matrix(model: mujoco.MjModel) -> np.ndarray:
        data = mujoco.MjData(model)
        data.qpos[:] = env.stance_qpos[0].numpy()
        mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        return full

    np.testing.assert_allclose(mass_matrix(scene), mass_matrix(trained), rtol=1e-9, atol=1e-12)
    nominal = np.eye(18)
    assert not np.allclose(mass_matrix(scene), nominal)


def test_manifest_is_the_trained_body(go2: BodyFactory, design: np.ndarray, bundle: deploy.Bundle) -> None:
    bodies = go2.batch(design[None])
    env = LeggedEnv(go2, design[None], task())
    assert bundle.joint_names == go2.layout.joints
    for name in ("kp", "kd", "torque_limit"):
        np.testing.assert_array_equal(bundle.per_joint(name), getattr(bodies, name)[0])
    np.testing.assert_allclose(bundle.per_joint("stance"), env.stance_q[0], atol=1e-6)
    np.testing.assert_allclose(bundle.per_joint("target_offset"), env.stance_ctrl[0], atol=1e-6)
    assert bundle.robot.total_mass == pytest.approx(bodies.total_mass[0])
    assert (bundle.action.scale, bundle.action.clip) == (env.task.action_scale, env.task.action_clip)


@pytest.fixture(scope="module")
def targets(bundle: deploy.Bundle) -> np.ndarray:
    """Joint targets that make the robot wave its legs, (STEPS, 12)."""
    phase = np.linspace(0.0, 2 * np.pi, STEPS)[:, None]
    return bundle.per_joint("target_offset") + 0.15 * np.sin(3 * phase + np.arange(12))


@pytest.fixture(scope="module")
def trajectory(go2: BodyFactory, design: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """Positions of the trained simulation, the second of three robots, (STEPS, 19)."""
    others = np.array([[1.0, 1.0, 1.0, 1.0], design, [1.1, 0.9, 1.0, 1.0]])
    env = LeggedEnv(go2, others, task())
    env.reset(seed=0)
    rows = []
    for target in targets:
        env.sim.ctrl[:] = torch.from_numpy(target)
        env.sim.step()
        rows.append(env.sim.qpos[1].numpy().copy())
    return np.array(rows)


def test_bundle_scene_moves_like_the_trained_body(
    scene: mujoco.MjModel, bundle: deploy.Bundle, targets: np.ndarray, trajectory: np.ndarray
) -> None:
    """Plain MuJoCo on scene.xml, the same targets, one second."""
    data = mujoco.MjData(scene)
    data.qpos[2] = bundle.start_height
    data.qpos[7:] = bundle.per_joint("stance")
    for target, expected in zip(targets, trajectory, strict=True):
        data.ctrl[:] = target
        for _ in range(round(1.0 / bundle.policy_hz / scene.opt.timestep)):
            mujoco.mj_step(scene, data)
        np.testing.assert_allclose(data.qpos, expected, atol=1e-6)
    assert np.ptp(trajectory[:, 7:], axis=0).min() > 0.05, "the legs hardly moved"


def test_deployed_robot_moves_like_the_trained_body(
    bundle: deploy.Bundle, targets: np.ndarray, trajectory: np.ndarray
) -> None:
    """deploy's simulated robot, its PD law and clock, the same targets."""
    robot = MujocoRobot(bundle, joint_noise=0.0)
    zeros, kp, kd = np.zeros(12), bundle.per_joint("kp"), bundle.per_joint("kd")
    order = [robot.spec.joint_names.index(name) for name in bundle.joint_names]
    assert order == list(range(12)), "joint orders differ: bind by name here"
    for tick, (target, expected) in enumerate(zip(targets, trajectory, strict=True), start=1):
        robot.write(JointCommand(target, zeros, kp, kd, zeros, robot.now_ns()))
        robot.sleep_until(tick * bundle.period_ns)
        np.testing.assert_allclose(robot.read().q, expected[7:], atol=1e-6)
        np.testing.assert_allclose(robot.truth().position, expected[:3], atol=1e-6)
