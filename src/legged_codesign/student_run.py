"""From a shipped generalist to a student's bundle for one body: fine-tune with ROA, distil, compare, export."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import distill
import locorl
import numpy as np
from distill.comparison import print_scores, table_of
from distill.evaluate import MemoryPolicy
from distill.film import evaluate_on_film
from locorl import LeggedEnv, Policy, TaskConfig, load_policy
from locorl.adapters.student import StudentEnv
from locorl.adapters.vision import VisionEnv, with_camera
from locorl.config import to_dict
from locorl.evaluation.evaluate import walking_protocol
from locorl.interfaces import Array
from morphgen import BodyFactory
from rich.console import Console

from legged_codesign.adapt import adapt, heading_columns
from legged_codesign.bundle import bundle_spec
from legged_codesign.config import DistilConfig
from legged_codesign.pretrained import shipped
from legged_codesign.provenance import provenance
from legged_codesign.robots import BodyConfig, body_factory
from legged_codesign.run_folder import bind
from legged_codesign.run_log import LoggedConsole
from legged_codesign.stages import Stage, locked, run_stages, write_text

_FILMED = 4
"""Robot that is filmed: on a map of ten levels, one of middling difficulty."""


@dataclass(frozen=True)
class StudentConfig:
    """Everything that determines a student.

    Attributes:
        robot: name of an installed body factory, or path of a URDF.
        bodies: how its bodies follow from designs.
        policy: the policy to start from: name of a shipped one, such as `go2-rough`, or path of a policy.
        design: the body; empty for the nominal one.
        terrain: kinds of terrain to take instead of those of the policy's task.
        seed: of everything random.
        distil: how the student is made.
    """

    robot: str = "go2"
    bodies: BodyConfig = field(default_factory=BodyConfig)
    policy: str = "go2-flat"
    design: tuple[float, ...] = ()
    terrain: tuple[str, ...] = ()
    seed: int = 0
    distil: DistilConfig = field(default_factory=DistilConfig)


class StudentRun:
    """One student over one folder; each stage reads its inputs from disk and is skipped if they have not changed.

    Args:
        config: what to do.
        folder: of the run.
        console: where to print.
        prepared: folder of another student, whose teacher, estimator and history encoder are taken as they are.
        bundle: folder of the bundle; by default `bundle` within `folder`.

    Attributes:
        teacher: the policy to imitate: fine-tuned beside ROA, or as it came.
        adaptation: its estimator and history encoder; there are none without ROA.
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
        self,
        config: StudentConfig,
        folder: Path,
        console: Console | None = None,
        prepared: Path | None = None,
        bundle: Path | None = None,
    ) -> None:
        self.config, self.folder, self.console = config, folder, console or Console()
        self.factory: BodyFactory = body_factory(config.robot, config.bodies)
        self.generalist = shipped(config.policy)
        design = config.design or tuple(self.factory.space.nominal)
        self.design: Array = locorl.repeat_design(self.factory, np.asarray(design, dtype=np.float64), 1)[0]
        self._check(load_policy(self.generalist))
        self._prepared = prepared is not None
        self.teacher = self.generalist if config.distil.adapt is None else (prepared or folder) / "teacher.pt"
        self.adaptation = (prepared or folder) / "adaptation.pt"
        self.student = folder / "student" / "student.pt"
        self.comparison, self.spec = folder / "comparison.json", folder / "spec.json"
        self.bundle = bundle or folder / "bundle"

    def run(self) -> Path:
        """Do all stages, or what is left of them; returns the folder of the bundle.

        Raises:
            RunError: the folder belongs to another configuration, is in use or cannot be written to.
        """
        samples = self.config.distil.samples / 1e6
        log = LoggedConsole(self.console)
        with locked(self.folder):
            bind(self.folder, self.config, "student")
            self.console = log
            with log.into(self.folder):
                self.console.print(f"[bold]{self.folder}[/bold]: {samples:.1f} M environment steps")
                run_stages(self.folder, self.stages(), self.console)
        return self.bundle

    def stages(self) -> list[Stage]:
        """What there is to do, in order."""
        # the policy counts by what is in it, wherever it lies
        settings = to_dict(replace(self.config, policy=""))
        adapted = [] if self.config.distil.adapt is None else [self.adaptation]
        stages = [
            Stage("distil", settings, [self.teacher, *adapted], [self.student], self.distil),
            Stage("compare", settings, [self.teacher, *adapted, self.student], [self.comparison], self.compare),
            Stage(
                "export",
                settings,
                [self.teacher, self.student, self.comparison],
                [self.spec, self.bundle / "manifest.json"],
                self.export,
            ),
        ]
        if adapted and not self._prepared:
            stages.insert(0, Stage("adapt", settings, [self.generalist], [self.teacher, *adapted], self.adapt))
        return stages

    def _check(self, generalist: Policy) -> None:
        """Refuse at once what would fail after minutes of work."""
        generalist.check_bodies(
            self.factory, "choose its rule, gains, kp and kd as in its training (--rule, --gains, --kp, --kd)"
        )
        check_student(generalist.card.task, self.config.distil, f"'{self.config.policy}'")

    def adapt(self) -> None:
        """Fine-tune the generalist on the body, with estimator and ROA, and report what the latent knows."""
        config, start = self.config, load_policy(self.generalist)
        if config.distil.adapt is None:
            raise RuntimeError("this student's teacher is taken as it is: nothing adapts it")
        _belong(self.folder / "adapt", [self.generalist])
        start = Policy(start.model, replace(start.card, task=self._ground(start.card.task)))
        tuning = config.distil.adapt
        teacher, networks = adapt(self.folder / "adapt", self.factory, start, self.design, tuning, config.seed)
        teacher.save(self.teacher)
        distill.save_adaptation(self.adaptation, networks)
        robots = np.tile(self.design, (max(128, 2 * networks.latent_dim), 1))
        simulator = tuning.finetune.simulator
        env = StudentEnv(LeggedEnv(self.factory, robots, teacher.card.task, seed=config.seed, simulator=simulator))
        columns = {term.name: env.env.layout.column("implicit", term.name) for term in env.env.layout.implicit}
        known = distill.identify(env, teacher, networks, columns, seed=config.seed)
        told = {name: value for name, value in known.r2.items() if np.isfinite(value)}
        write_text(self.folder / "identification.json", json.dumps(told, indent=1) + "\n")
        text = ", ".join(f"{name} {value:.2f}" for name, value in told.items())
        self.console.print(f"  R^2 of linear probes of the history latent: {text}", highlight=False, soft_wrap=True)

    def distil(self) -> None:
        """Teach the student."""
        config, seed, teacher = self.config.distil, self.config.seed, self._teacher()
        folder = self.student.parent
        adapted = [] if config.adapt is None else [self.adaptation]
        _belong(folder, [self.teacher, *adapted])
        env = self._env(self._onboard(teacher.card.task), config.robots)
        if isinstance(env, VisionEnv):
            vision = replace(config.vision, seed=seed, roa=config.vision.roa and bool(adapted))
            networks = distill.load_adaptation(self.adaptation) if vision.roa else None
            distill.train_vision(env, teacher, folder, vision, config.vision_student, networks)
        else:
            distill.train(env, teacher, folder, replace(config.imitation, seed=seed), config.student)

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
        """Teacher, adapted teacher and student, without noise and pushes, on ground that no training has seen.

        Args:
            video: film of one robot under each, as an .mp4; None makes none.
        """
        protocol, teacher = self.config.distil.judged, self._teacher()
        task = walking_protocol(teacher.card.task, protocol)
        task = replace(task, terrain=replace(task.terrain, seed=protocol.seed))
        env = self._env(task, protocol.robots_per_body)
        policies: dict[str, MemoryPolicy | distill.Teacher] = {"teacher": teacher}
        if self.config.distil.adapt is not None:
            networks = distill.load_adaptation(self.adaptation, env.device)
            policies["teacher on history latent"] = distill.AdaptedTeacher(teacher, networks)
        policies["student"] = self._policy(teacher, env)
        teacher.model.to(env.device)  # only its own `act` would take it there
        steps, seed = round(protocol.seconds / env.env.dt), protocol.seed
        if video is not None:
            return evaluate_on_film(env, policies, steps, seed, video, min(_FILMED, env.num_envs - 1))
        return {name: distill.evaluate(env, policy, steps, seed) for name, policy in policies.items()}

    def export(self) -> None:
        """Write what the bundle says of the robot, and the bundle."""
        config, teacher = self.config.distil, self._teacher()
        training = {
            "config": to_dict(self.config),
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
            return distill.VisionPolicy(distill.load_vision_student(self.student, teacher, env.device), env)
        student = distill.load_student(self.student, teacher, env.device)
        return distill.StudentPolicy(student, env.num_envs, env.device)

    def _env(self, task: TaskConfig, robots: int) -> StudentEnv:
        """Robots with the chosen body on all tiles, with cameras if the student sees."""
        config = self.config.distil
        if config.depth:
            task = with_camera(task, config.camera, task.observation.history)
        designs = np.tile(self.design, (robots, 1))
        env = LeggedEnv(self.factory, designs, task, seed=self.config.seed, simulator=config.simulator)
        return VisionEnv(env) if config.depth else StudentEnv(env)

    def _teacher(self) -> Policy:
        """The teacher on the ground of this student."""
        teacher = load_policy(self.teacher)
        return Policy(teacher.model, replace(teacher.card, task=self._ground(teacher.card.task)))

    def _ground(self, task: TaskConfig) -> TaskConfig:
        """The task on the chosen kinds of terrain."""
        return task.on(self.config.terrain) if self.config.terrain else task

    @staticmethod
    def _onboard(task: TaskConfig) -> TaskConfig:
        """The task without the observed history: a student remembers by itself."""
        return replace(task, observation=replace(task.observation, history=0))


@dataclass(frozen=True)
class WaysOut:
    """What a command says to do about a student whose eyes do not fit; the defaults are those of `codesign student`."""

    blind: str = "add --depth"
    """Where it must see."""
    seeing: str = "leave --depth out, or take a policy for courses, such as lite3-parkour"
    """Where there is nothing for it to find."""


def check_student(task: TaskConfig, config: DistilConfig, policy: str, ways_out: WaysOut | None = None) -> None:
    """Refuse a student that cannot know the way, or that has no way to find.

    Args:
        task: of the teacher.
        config: the student.
        policy: name of the teacher, for messages.
        ways_out: likewise, the options of the command.

    Raises:
        ValueError: says what to choose instead.
    """
    ways_out = ways_out or WaysOut()
    led = len(heading_columns(task, 0)) > 0
    if led and not config.depth:
        raise ValueError(f"{policy} is told the way to go, which no sensor gives: a student must see; {ways_out.blind}")
    if config.depth and not led:
        raise ValueError(
            f"{policy} follows commanded velocities alone: its teacher is told no way to go, from which a student that "
            f"sees would learn to find it; {ways_out.seeing}"
        )


def _belong(folder: Path, origins: Sequence[Path]) -> None:
    """Keep what a training left in `folder` if it started from the same files; another one must not be resumed."""
    mine = " ".join(hashlib.sha256(path.read_bytes()).hexdigest() for path in origins)
    note = folder / "of.sha256"
    if folder.exists() and not (note.exists() and note.read_text(encoding="utf-8") == mine):
        shutil.rmtree(folder)
    write_text(note, mine)
