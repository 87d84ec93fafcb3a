"""From a shipped generalist to a student's bundle for one body: fine-tune with ROA, distil, compare, export."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import distill
import locorl
import numpy as np
import yaml
from distill.comparison import print_scores, table_of
from distill.evaluate import MemoryPolicy
from distill.film import evaluate_on_film
from locorl import DepthConfig, EvalConfig, LeggedEnv, Policy, TaskConfig, load_policy
from locorl.adapters.student import StudentEnv
from locorl.adapters.vision import VisionEnv, with_camera
from locorl.config import differences, to_dict
from locorl.evaluation.evaluate import walking_protocol
from locorl.interfaces import Array
from morphgen import BodyFactory
from rich.console import Console

from legged_codesign.adapt import AdaptConfig, adapt, heading_columns
from legged_codesign.pretrained import shipped
from legged_codesign.provenance import provenance
from legged_codesign.robots import body_factory
from legged_codesign.stages import RunError, Stage, locked, run_stages, write_text
from legged_codesign.student import bundle_spec

_FILMED = 4
"""Robot that is filmed: on a map of ten levels, one of middling difficulty."""


@dataclass(frozen=True)
class StudentConfig:
    """Everything that determines a student.

    Attributes:
        robot: name of an installed body factory, or path of a URDF.
        policy: the generalist to start from: name of a shipped one, such as `go2-rough`, or path of a policy.
        design: the body; empty for the nominal one.
        terrain: kinds of terrain to take instead of those of the generalist's task.
        depth: whether the student sees.
        seed: of everything random.
        adapt: the fine-tune that prepares the teacher.
        robots: that the student is trained with.
        imitation: training of a blind student.
        student: its architecture.
        vision: training of a seeing student.
        vision_student: its architecture and timing.
        camera: of a seeing student.
        judged: how teacher and student are compared; speed, seconds, robots and seed.
    """

    robot: str = "go2"
    policy: str = "go2-flat"
    design: tuple[float, ...] = ()
    terrain: tuple[str, ...] = ()
    depth: bool = False
    seed: int = 0
    adapt: AdaptConfig = field(default_factory=AdaptConfig)
    robots: int = 256
    imitation: distill.TrainConfig = field(default_factory=distill.TrainConfig)
    student: distill.StudentConfig = field(default_factory=distill.StudentConfig)
    vision: distill.VisionTrainConfig = field(default_factory=distill.VisionTrainConfig)
    vision_student: distill.VisionStudentConfig = field(default_factory=distill.VisionStudentConfig)
    camera: DepthConfig = field(default_factory=DepthConfig.small)
    judged: EvalConfig = field(default_factory=lambda: EvalConfig(robots_per_body=100, reset_joint=0.1, seed=4242))

    @property
    def samples(self) -> int:
        """Environment steps of the fine-tune and of the student's training."""
        train = self.vision if self.depth else self.imitation
        return self.adapt.finetune.samples + train.iterations * train.rollout_steps * self.robots


class StudentRun:
    """One student over one folder; each stage reads its inputs from disk and is skipped if they have not changed.

    Args:
        config: what to do.
        folder: of the run.
        console: where to print.
        prepared: folder of another student, whose teacher, estimator and history encoder are taken as they are.

    Attributes:
        teacher: the fine-tuned policy.
        adaptation: its estimator and history encoder.
        student: the trained student.
        comparison: means and results robot by robot of teacher and student, JSON.
        spec: what the bundle says of the robot, JSON.
        bundle: folder of the bundle.

    Raises:
        LookupError: no installed package knows the robot.
        FileNotFoundError: no such policy ships.
        ValueError: generalist, robot and body do not fit together.
    """

    def __init__(
        self, config: StudentConfig, folder: Path, console: Console | None = None, prepared: Path | None = None
    ) -> None:
        self.config, self.folder, self.console = config, folder, console or Console()
        self.factory: BodyFactory = body_factory(config.robot)
        self.generalist = shipped(config.policy)
        design = config.design or tuple(self.factory.space.nominal)
        self.design: Array = locorl.repeat_design(self.factory, np.asarray(design, dtype=np.float64), 1)[0]
        self._check(load_policy(self.generalist))
        self._prepared = prepared is not None
        self.teacher, self.adaptation = (prepared or folder) / "teacher.pt", (prepared or folder) / "adaptation.pt"
        self.student = folder / "student" / "student.pt"
        self.comparison, self.spec = folder / "comparison.json", folder / "spec.json"
        self.bundle = folder / "bundle"

    def run(self) -> Path:
        """Do all stages, or what is left of them; returns the folder of the bundle.

        Raises:
            RunError: the folder belongs to another configuration, is in use or cannot be written to.
        """
        settings: Mapping[str, object] = to_dict(self.config)
        self.console.print(f"[bold]{self.folder}[/bold]: {self.config.samples / 1e6:.1f} M environment steps")
        with locked(self.folder):
            self._bind(settings)
            stages = (
                Stage("adapt", settings, [self.generalist], [self.teacher, self.adaptation], self.adapt),
                Stage("distil", settings, [self.teacher, self.adaptation], [self.student], self.distil),
                Stage(
                    "compare", settings, [self.teacher, self.adaptation, self.student], [self.comparison], self.compare
                ),
                Stage(
                    "export",
                    settings,
                    [self.teacher, self.student, self.comparison],
                    [self.spec, self.bundle / "manifest.json"],
                    self.export,
                ),
            )
            run_stages(self.folder, stages[1:] if self._prepared else stages, self.console)
        return self.bundle

    def _check(self, generalist: Policy) -> None:
        """Refuse at once what would fail after minutes of work."""
        generalist.check_space(self.factory.name, self.factory.space)
        card = generalist.card
        led = len(heading_columns(card.task, len(card.design_names))) > 0
        if led and not self.config.depth:
            raise ValueError(
                f"'{self.config.policy}' is told the way to go, which no sensor gives: a student must see; add --depth"
            )
        if self.config.depth and not led:
            raise ValueError(
                f"'{self.config.policy}' follows commands alone and has no way to find: leave --depth out, or take a "
                "policy for courses, such as lite3-parkour"
            )

    def adapt(self) -> None:
        """Fine-tune the generalist on the body, with estimator and ROA, and report what the latent knows."""
        config, start = self.config, load_policy(self.generalist)
        _belong(self.folder / "adapt", [self.generalist])
        start = Policy(start.model, replace(start.card, task=self._ground(start.card.task)))
        teacher, networks = adapt(self.folder / "adapt", self.factory, start, self.design, config.adapt, config.seed)
        teacher.save(self.teacher)
        distill.save_adaptation(self.adaptation, networks)
        robots = np.tile(self.design, (max(128, 2 * networks.latent_dim), 1))
        env = StudentEnv(LeggedEnv(self.factory, robots, teacher.card.task, seed=config.seed))
        columns = {term.name: env.env.layout.column("implicit", term.name) for term in env.env.layout.implicit}
        known = distill.identify(env, teacher, networks, columns, seed=config.seed)
        told = {name: value for name, value in known.r2.items() if np.isfinite(value)}
        write_text(self.folder / "identification.json", json.dumps(told, indent=1) + "\n")
        text = ", ".join(f"{name} {value:.2f}" for name, value in told.items())
        self.console.print(f"  R^2 of linear probes of the history latent: {text}", highlight=False, soft_wrap=True)

    def distil(self) -> None:
        """Teach the student."""
        config, teacher = self.config, load_policy(self.teacher)
        folder = self.student.parent
        _belong(folder, [self.teacher, self.adaptation])
        env = self._env(self._onboard(teacher.card.task), config.robots)
        if isinstance(env, VisionEnv):
            vision = replace(config.vision, seed=config.seed)
            networks = distill.load_adaptation(self.adaptation) if vision.roa else None
            distill.train_vision(env, teacher, folder, vision, config.vision_student, networks)
        else:
            distill.train(env, teacher, folder, replace(config.imitation, seed=config.seed), config.student)

    def compare(self) -> None:
        """Score teacher and student on the same starts, and the teacher on estimated velocity and history latent."""
        scores = self.scores()
        print_scores(self.console, scores)
        robots = {
            name: {
                "returns": score.returns.tolist(),
                "survived": score.survived.tolist(),
                "succeeded": None if score.succeeded is None else score.succeeded.tolist(),
            }
            for name, score in scores.items()
        }
        write_text(self.comparison, json.dumps({"means": table_of(scores), "robots": robots}, indent=1) + "\n")

    def scores(self, video: Path | None = None) -> dict[str, distill.Score]:
        """Teacher, adapted teacher and student, without noise and pushes and spread over all tiles.

        Args:
            video: film of one robot under each, as an .mp4; None makes none.
        """
        config, teacher = self.config, load_policy(self.teacher)
        judged = walking_protocol(teacher.card.task, config.judged)
        env = self._env(judged, config.judged.robots_per_body, spread=True)
        adapted = distill.AdaptedTeacher(teacher, distill.load_adaptation(self.adaptation))
        policies: dict[str, MemoryPolicy | distill.Teacher] = {
            "teacher": teacher,
            "teacher on history latent": adapted,
            "student": self._policy(teacher, env),
        }
        steps, seed = round(config.judged.seconds / env.env.dt), config.judged.seed
        if video is not None:
            return evaluate_on_film(env, policies, steps, seed, video, min(_FILMED, env.num_envs - 1))
        return {name: distill.evaluate(env, policy, steps, seed) for name, policy in policies.items()}

    def export(self) -> None:
        """Write what the bundle says of the robot, and the bundle."""
        config, teacher = self.config, load_policy(self.teacher)
        training = {
            "config": to_dict(config),
            "comparison": json.loads(self.comparison.read_text(encoding="utf-8"))["means"],
            "provenance": provenance(),
        }
        spec = bundle_spec(self.factory, teacher, self.design, training, config.camera if config.depth else None)
        distill.write_spec(spec, self.spec)
        if config.depth:
            distill.export_vision_bundle(self.bundle, distill.load_vision_student(self.student, teacher), spec)
        else:
            distill.export_bundle(self.bundle, distill.load_student(self.student, teacher), spec)

    def _policy(self, teacher: Policy, env: StudentEnv) -> MemoryPolicy:
        if isinstance(env, VisionEnv):
            return distill.VisionPolicy(distill.load_vision_student(self.student, teacher), env)
        return distill.StudentPolicy(distill.load_student(self.student, teacher), env.num_envs)

    def _env(self, task: TaskConfig, robots: int, spread: bool = False) -> StudentEnv:
        """Robots with the chosen body, with cameras if the student sees."""
        if self.config.depth:
            task = with_camera(task, self.config.camera, task.observation.history)
        designs = np.tile(self.design, (robots, 1))
        env = LeggedEnv(self.factory, designs, task, seed=self.config.seed)
        return VisionEnv(env, spread) if self.config.depth else StudentEnv(env, spread)

    def _ground(self, task: TaskConfig) -> TaskConfig:
        """The task on the chosen kinds of terrain."""
        kinds = self.config.terrain
        if not kinds:
            return task
        return replace(task, terrain=replace(task.terrain, kinds=kinds, columns=len(kinds)))

    @staticmethod
    def _onboard(task: TaskConfig) -> TaskConfig:
        """The task without the observed history: a student remembers by itself."""
        return replace(task, observation=replace(task.observation, history=0))

    def _bind(self, settings: Mapping[str, object]) -> None:
        """Write config.yaml before anything starts, or make sure that the folder is this run's."""
        path = self.folder / "config.yaml"
        if path.exists():
            try:
                stored = yaml.safe_load(path.read_text(encoding="utf-8"))
                changes = differences(stored["config"], settings)
            except (yaml.YAMLError, UnicodeDecodeError, KeyError, TypeError) as error:
                raise RunError(f"{path} is damaged ({error}); restore it or choose another --folder") from error
            if changes:
                raise RunError(
                    f"{self.folder} holds another student; choose another --folder or delete it.\n  "
                    + "\n  ".join(changes)
                )
            return
        content = {"config": settings, "provenance": provenance()}
        write_text(path, yaml.safe_dump(content, sort_keys=False))


def _belong(folder: Path, origins: Sequence[Path]) -> None:
    """Keep what a training left in `folder` if it started from the same files; another one must not be resumed."""
    mine = " ".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in origins)
    note = folder / "of.sha256"
    if folder.exists() and not (note.exists() and note.read_text(encoding="utf-8") == mine):
        shutil.rmtree(folder)
    write_text(note, mine)
