"""`codesign student`: a generalist becomes a student's bundle for one body, in stages that go on where they stopped."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import deploy
import distill
import mujoco
import numpy as np
import pytest
import torch
from deploy.robots.mujoco_robot import MujocoRobot
from distill import checkpoint
from distill.student import blind_payload, build_student
from locorl import (
    EvalConfig,
    FinetuneConfig,
    LeggedEnv,
    Policy,
    PPOConfig,
    SimulatorConfig,
    TaskConfig,
    find_factory,
    load_policy,
    make_task,
)
from locorl.env.observation import observation_layout
from locorl.terrain.map import TerrainMap

from legged_codesign import adapt, cli, student_run
from legged_codesign.adapt import Adaptation, AdaptConfig, heading_columns
from legged_codesign.commands import student
from legged_codesign.config import DistilConfig
from legged_codesign.pretrained import shipped
from legged_codesign.robots import BodyConfig
from legged_codesign.scene import training_scene
from legged_codesign.stages import RunError
from legged_codesign.student_run import StudentConfig, StudentRun

ADAPT = AdaptConfig(
    finetune=FinetuneConfig(num_envs=8, iterations=2, ppo=PPOConfig(steps=6, minibatches=2, epochs=1)),
    networks=distill.AdaptationConfig(history=5, frame_features=8, channels=(8,), features=16, estimator=(16,)),
)
DISTIL = DistilConfig(
    adapt=ADAPT,
    robots=8,
    imitation=distill.TrainConfig(iterations=2, rollout_steps=6, segment=1, updates=2, batch=32, ring_rollouts=2),
    vision=distill.VisionTrainConfig(iterations=2, rollout_steps=10, segment=1, updates=1, batch=8),
    judged=EvalConfig(seconds=0.6, settle=0.1, robots_per_body=6, reset_joint=0.1, seed=3),
)
TINY = StudentConfig(distil=DISTIL)
DEPTH = StudentConfig("lite3", policy="lite3-parkour", terrain=("hurdles",), distil=replace(DISTIL, depth=True))


# ---------------------------------------------------------------- the ground of the bundle


@pytest.mark.parametrize("name", ["locomotion-flat", "locomotion-rough", "parkour-mixed"])
def test_a_robot_at_the_origin_of_the_scene_stands_where_training_starts(name: str) -> None:
    """Rays downwards from a grid around the origin find the ground that the training's height grid has there."""
    task = make_task(name)
    scene, ground = training_scene(task), TerrainMap(task.terrain)
    text = scene.to_xml() if name == "locomotion-flat" else None
    model = scene.compile()
    assert text is None or mujoco.MjModel.from_xml_string(text).ngeom == model.ngeom
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    level = min(task.curriculum.start_level, len(ground.difficulty) - 1)
    start = ground.origins[level, 0].double().numpy()
    hit = np.zeros(1, np.int32)
    for x in np.linspace(-0.3, 6.0, 22):
        for y in (-0.31, 0.0, 0.33):
            top = np.array((x, y, 3.0))
            height = 3.0 - mujoco.mj_ray(model, data, top, np.array((0.0, 0.0, -1.0)), None, 1, -1, hit)
            wanted = ground.ground(np.array([start[0] + x]), np.array([start[1] + y]))[0] - start[2]
            assert height == pytest.approx(wanted, abs=0.03)  # a triangle of the field and its bilinear surface differ
    assert (ground.field is None) == (name != "locomotion-rough")


def test_headings_are_what_no_sensor_gives() -> None:
    parkour, flat = make_task("parkour-mixed"), TaskConfig()
    assert heading_columns(parkour, 4) == range(6, 8)
    assert len(heading_columns(flat, 4)) == 0


# ---------------------------------------------------------------- the run


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> StudentRun:
    run = StudentRun(replace(TINY, design=(1.0, 1.1, 0.95, 1.1)), tmp_path_factory.mktemp("students") / "flat")
    run.run()
    return run


@pytest.mark.slow
def test_the_bundle_is_the_students_and_runs(done: StudentRun) -> None:
    bundle = deploy.load_bundle(done.bundle)
    assert dict(bundle.robot.design) == pytest.approx(
        dict(zip(done.factory.space.names, (1.0, 1.1, 0.95, 1.1), strict=True))
    )
    MujocoRobot(bundle)
    teacher = load_policy(done.teacher)
    assert teacher.card.task.observation.history == 4
    student = distill.load_student(done.student, teacher)
    again = distill.export_bundle(done.folder / "again", student, distill.read_spec(done.spec))
    for name in ("robot.urdf", "robot.xml", "scene.xml"):
        assert (again / name).read_bytes() == (done.bundle / name).read_bytes()


@pytest.mark.slow
def test_the_comparison_has_all_three_and_every_robot(done: StudentRun) -> None:
    found = json.loads(done.comparison.read_text())
    assert set(found["means"]) == {"teacher", "teacher on history latent", "student"}
    for name, robots in found["robots"].items():
        assert len(robots["returns"]) == 6
        assert np.mean(robots["returns"]) == pytest.approx(found["means"][name]["all"]["return"], rel=1e-5)
        assert robots["succeeded"] is None
    known = json.loads((done.folder / "identification.json").read_text())
    assert {"friction", "joint_damping"} <= set(known)
    assert not any(name.startswith("design") for name in known)  # one body: nothing to tell apart


@pytest.mark.slow
def test_a_finished_run_is_left_alone_and_a_stage_that_lost_its_files_is_done_again(done: StudentRun) -> None:
    before = {path: path.stat().st_mtime_ns for path in done.folder.rglob("*.pt")}
    weights = torch.load(done.student, weights_only=True)["student"]["weights"]
    StudentRun(done.config, done.folder).run()
    assert {path: path.stat().st_mtime_ns for path in before} == before
    done.student.unlink()
    (done.student.parent / "checkpoint.pt").unlink()
    StudentRun(done.config, done.folder).run()
    again = torch.load(done.student, weights_only=True)["student"]["weights"]
    assert all(torch.equal(value, weights[name]) for name, value in again.items())
    with pytest.raises(RunError, match="seed"):
        StudentRun(replace(done.config, seed=7), done.folder).run()


@pytest.mark.slow
def test_a_second_student_of_the_same_teacher_takes_it_over(done: StudentRun, tmp_path: Path) -> None:
    other = StudentRun(replace(done.config, distil=replace(DISTIL, robots=4)), tmp_path / "other", prepared=done.folder)
    other.run()
    assert not (other.folder / "adapt").exists()
    assert other.teacher == done.teacher
    assert (other.bundle / "manifest.json").is_file()


@pytest.mark.slow
def test_a_seeing_student_of_the_shipped_parkour_policy(tmp_path: Path) -> None:
    run = StudentRun(DEPTH, tmp_path / "depth")
    run.run()
    manifest = json.loads((run.bundle / "manifest.json").read_text())
    assert manifest["depth"]["image"]["rows"] == 24
    found = json.loads(run.comparison.read_text())
    assert found["robots"]["student"]["succeeded"] == [False] * 6  # nobody is through in 0.6 s
    assert set(found["means"]["student"]["terrain"]) == {"hurdles"}


def test_what_cannot_work_is_refused_before_anything_starts(tmp_path: Path, untrained: Policy) -> None:
    with pytest.raises(ValueError, match="must see; add --depth"):
        StudentRun(replace(DEPTH, distil=DISTIL), tmp_path / "a")
    with pytest.raises(ValueError, match="leave --depth out"):
        StudentRun(replace(TINY, distil=replace(DISTIL, depth=True)), tmp_path / "a")
    with pytest.raises(ValueError, match="trained on 'go2'"):
        StudentRun(replace(TINY, robot="lite3"), tmp_path / "a")
    with pytest.raises(ValueError, match="not in"):
        StudentRun(replace(TINY, design=(3.0, 1.0, 1.0, 1.0)), tmp_path / "a")
    untrained.save(tmp_path / "mine.pt")
    mine = replace(TINY, policy=str(tmp_path / "mine.pt"))
    with pytest.raises(ValueError, match=r"gains: none in its training, mass here.*--rule, --gains, --kp, --kd"):
        StudentRun(replace(mine, bodies=BodyConfig(gains="mass")), tmp_path / "x")
    with pytest.raises(FileNotFoundError, match=r"there is: .*go2-flat"):
        StudentRun(replace(TINY, policy="go2-moon"), tmp_path / "a")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.pt"]


def test_the_command_stands_for_a_configuration(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr(
        student, "StudentRun", lambda config, folder, console: asked.append((config, folder)) or _Nothing()
    )
    for arguments in (
        "student --robot go2 --policy go2-rough --design 1 1.1 1 1.1 --terrain hills",
        "student --robot lite3 --policy lite3-parkour --depth --iterations 9 --adapt-iterations 5",
    ):
        monkeypatch.setattr("sys.argv", ["codesign", *arguments.split()])
        cli.main()
    (blind, first), (seeing, second) = asked
    assert (blind.design, blind.terrain, blind.distil.robots) == ((1.0, 1.1, 1.0, 1.1), ("hills",), 256)
    assert (seeing.distil.depth, seeing.distil.robots, seeing.distil.vision.iterations) == (True, 128, 9)
    assert seeing.distil.adapt.finetune.iterations == 5
    assert (first.name, second.name) == ("student-go2-rough", "student-lite3-parkour-depth")


class _Nothing:
    def run(self) -> Path:
        return Path("bundle")


# ---------------------------------------------------------------- ROA on many bodies


def test_the_same_hooks_learn_on_many_bodies() -> None:
    """The networks are those of the seed, blank where no sensor looks, and start alike."""
    teacher = load_policy(shipped("lite3-parkour"))
    first, second = (Adaptation(teacher, ADAPT, seed).networks for seed in (1, 1))
    assert first.blank == (6, 7)
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))
    env = LeggedEnv(find_factory("lite3"), np.ones((2, 4)), teacher.card.task, seed=1)
    assert first.proprio == env.group_dims["proprio"]


# ---------------------------------------------------------------- a simulator on a GPU


GPU = SimulatorConfig("warp", "meta")
"""A device that refuses to compute with tensors of another, as a GPU does, and is on every machine."""


class Robots:
    """Robots on another device, as far as networks see them."""

    def __init__(self, _: object, designs: np.ndarray, task: TaskConfig, *, simulator: SimulatorConfig, **__: object):
        self.device, self.dt, self.num_envs = torch.device(simulator.device), 0.02, len(designs)
        self.group_dims = observation_layout(task.observation, designs.shape[1]).dims

    def observation(self) -> dict[str, torch.Tensor]:
        return {name: torch.zeros(self.num_envs, width, device=self.device) for name, width in self.group_dims.items()}


def test_what_is_compared_acts_where_the_robots_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = StudentRun(replace(TINY, distil=replace(DISTIL, simulator=GPU)), tmp_path)
    start = load_policy(run.generalist)
    task = replace(start.card.task, observation=replace(start.card.task.observation, history=ADAPT.past))
    teacher = Policy(start.model, replace(start.card, task=task))
    teacher.save(run.teacher)
    distill.save_adaptation(run.adaptation, Adaptation(teacher, ADAPT, seed=0).networks)
    network = build_student(teacher.card.dims["proprio"], teacher, run.config.distil.student)
    checkpoint.save(run.student, blind_payload(network))

    def act_once(env: student_run.StudentEnv, policy: distill.Teacher, *_: object) -> torch.device:
        action = policy.act(env.env.observation())  # pyright: ignore[reportAttributeAccessIssue]
        assert action.shape == (6, 12)
        return action.device

    monkeypatch.setattr(student_run, "LeggedEnv", Robots)
    monkeypatch.setattr(distill, "evaluate", act_once)
    names = ("teacher", "teacher on history latent", "student")
    assert run.scores() == dict.fromkeys(names, torch.device("meta"))


def test_what_learns_beside_the_teacher_is_where_the_robots_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the rollouts of the fine-tune, and with the robots that say what the latent knows."""
    config = replace(ADAPT, finetune=replace(ADAPT.finetune, simulator=GPU))
    run = StudentRun(replace(TINY, distil=replace(DISTIL, adapt=config)), tmp_path)
    seen: list[torch.device] = []

    def tune(start: Policy, factory: object, design: np.ndarray, tuning: FinetuneConfig, *_: object, **more: object):
        observed = replace(start.card.task.observation, history=ADAPT.past)
        robots = Robots(None, design[None], replace(start.card.task, observation=observed), simulator=tuning.simulator)
        estimation, _ = more["hooks"]  # pyright: ignore[reportGeneralTypeIssues]
        estimation.begin(10)
        seen.append(estimation.observe(robots.observation())["explicit"].device)
        return Tuned(start)

    def identify(
        env: student_run.StudentEnv, _: object, networks: distill.AdaptationModule, *__: object, **___: object
    ):
        seen.extend((env.device, next(networks.parameters()).device))
        return distill.Identification({}, 0, 0)

    class Tuned:
        def __init__(self, policy: Policy) -> None:
            self.policy = policy

    class Watched(Robots):
        layout = LeggedEnv(find_factory("go2"), np.ones((1, 4)), TaskConfig()).layout

    monkeypatch.setattr(adapt, "finetune", tune)
    monkeypatch.setattr(student_run, "LeggedEnv", Watched)
    monkeypatch.setattr(distill, "identify", identify)
    monkeypatch.setattr(distill, "save_adaptation", lambda *_: None)  # no data to save there
    run.adapt()
    assert seen == [torch.device("meta")] * 3
