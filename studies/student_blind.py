r"""How much of its teacher a student without eyes and privileges keeps.

    python studies/student_blind.py --seeds 1

For the shipped Go2 generalists of level ground and of hills: fine-tunes each on the nominal body while estimator and
ROA learn beside it, distils a student that has its joints and gyro alone, and compares both on the same commands and
starts. Then lets the history encoder learn on many bodies and asks linear probes what it knows of their legs. Works in
runs/studies/student-blind (killed at any moment, the same command goes on) and writes results/go2-student-blind.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import distill
import numpy as np
import tyro
from locorl import (
    LeggedEnv,
    PPOConfig,
    TrainConfig,
    Trainer,
    find_factory,
    load_policy,
    read_metrics,
    sample_designs,
)
from locorl.interfaces import Array
from study import RUNS, markdown_table, paired_difference, paired_ratio, unseen_bodies, write_results

from legged_codesign.adapt import Adaptation, AdaptConfig
from legged_codesign.config import DistilConfig
from legged_codesign.pretrained import shipped
from legged_codesign.stages import write_text
from legged_codesign.student_run import StudentConfig, StudentRun

FOLDER = RUNS / "student-blind"
GROUNDS: Mapping[str, tuple[str, tuple[str, ...]]] = {"flat": ("go2-flat", ()), "hills": ("go2-rough", ("hills",))}
"""Ground -> generalist and kinds of terrain."""
LEGS = ("front thigh", "front shank", "hind thigh", "hind shank")
SHARE, POINTS, MINUTES, KNOWN = 0.95, 3.0, 10.0, 0.5
"""Asked: return of the teacher's, points of survival lost, minutes of training, R^2 of leg scales."""


@dataclass(frozen=True)
class Options:
    """Options."""

    seeds: tuple[int, ...] = (1,)
    """Of the students."""
    config: StudentConfig = field(
        default_factory=lambda: StudentConfig(distil=DistilConfig(imitation=distill.TrainConfig(iterations=256)))
    )
    """Of each student; ground and seed are put in."""
    bodies: TrainConfig = field(
        default_factory=lambda: TrainConfig(
            num_envs=1024, iterations=60, ppo=PPOConfig(learning_rate=2e-4, max_learning_rate=1e-3)
        )
    )
    """The training on many bodies whose latent is probed."""
    probe_robots: int = 512
    """Robots, each with a body that training has not seen, that probes are fitted to and judged on."""


def main() -> None:
    """Train, compare, probe, record."""
    options = tyro.cli(Options, description=__doc__)
    rows, facts = [], {}
    for ground in GROUNDS:
        for seed in options.seeds:
            facts[f"{ground}, seed {seed}"] = found = student(options, ground, seed)
            rows.append(table_row(ground, seed, found))
    known = {seed: identification(options, seed) for seed in options.seeds}
    probes = [
        (str(seed), *(f"{r2:.2f}" for r2 in row.values()), verdict(min(row[leg] for leg in LEGS) > KNOWN))
        for seed, row in known.items()
    ]
    names = next(iter(known.values()))
    robots = options.config.distil.judged.robots_per_body
    lines = [
        f"Asked: at least {SHARE:.0%} of the teacher's return, survival within {POINTS:g} points, at most "
        f"{MINUTES:g} minutes of training. {robots} robots on the nominal Go2 with the same "
        "commands and starts, 20 s, spread over all tiles; 95 % intervals are bootstraps over the robots, paired.",
        "",
        *markdown_table(COLUMNS, rows),
        "",
        f"What linear probes of the history latent know of {options.probe_robots} bodies that training has not seen, "
        f"R^2 on held-out robots (asked: leg scales above {KNOWN:g}):",
        "",
        *markdown_table(("seed", *names, "as asked"), probes),
    ]
    folder = write_results("go2-student-blind", lines, {"students": facts, "identification": known}, options.seeds)
    print("\n".join(lines), f"-> {folder}", sep="\n")


def student(options: Options, ground: str, seed: int) -> dict[str, Any]:
    """One student, or the rest of one: comparison, minutes and samples of its training."""
    policy, terrain = GROUNDS[ground]
    config = replace(options.config, policy=policy, terrain=terrain, seed=seed)
    run = StudentRun(config, FOLDER / f"{ground}-seed-{seed}")
    run.run()
    metrics = read_metrics(run.student.parent / "metrics.jsonl")
    return {
        **json.loads(run.comparison.read_text(encoding="utf-8")),
        "minutes": sum(row["seconds"] for row in metrics) / 60.0,
        "samples": metrics[-1]["samples"],
    }


def identification(options: Options, seed: int) -> dict[str, float]:
    """Quantity -> R^2, after a training with ROA on many bodies, or the rest of one."""
    folder = FOLDER / f"bodies-seed-{seed}"
    path = folder / "identification.json"
    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))
    factory, generalist = find_factory("go2"), load_policy(shipped("go2-flat"))
    config = AdaptConfig()
    task = generalist.card.task
    task = replace(task, observation=replace(task.observation, history=config.past))
    train = replace(options.bodies, seed=seed, task=task)
    adaptation = Adaptation(generalist, config, seed)
    designs = sample_designs(factory, train.num_envs, np.random.default_rng(seed))
    trainer = Trainer(factory, train, folder, designs=designs, start=generalist, hooks=adaptation.hooks)
    adaptation.attach(trainer.model)
    trainer.run(f"ROA on many bodies, seed {seed}")
    others = unseen_bodies(factory, options.probe_robots)
    env = LeggedEnv(factory, others, task, seed=seed)
    columns = {name: slice(index, index + 1) for index, name in enumerate(LEGS)}
    columns |= {name: env.layout.column("implicit", name) for name in ("mass_ratio", "friction", "joint_damping")}
    found = distill.identify(env, trainer.policy(), adaptation.networks, columns, seed=seed)
    write_text(path, json.dumps(dict(found.r2), indent=1) + "\n")
    return dict(found.r2)


COLUMNS = (
    "ground",
    "seed",
    "return, teacher",
    "return, student",
    "student / teacher",
    "survival, teacher",
    "survival, student",
    "difference, points",
    "tracking error, m/s",
    "minutes",
    "k samples",
    "as asked",
)


def table_row(ground: str, seed: int, found: Mapping[str, Any]) -> list[str]:
    """Returns, survival and minutes of a student beside its teacher's."""
    means, robots = found["means"], found["robots"]

    def both(name: str) -> tuple[Array, Array]:
        student, teacher = (np.asarray(robots[who][name], dtype=np.float64) for who in ("student", "teacher"))
        return student, teacher

    share, low, high = paired_ratio(*both("returns"))
    lost, least, most = (100.0 * each for each in paired_difference(*both("survived")))
    teacher, student = means["teacher"]["all"], means["student"]["all"]
    good = share >= SHARE and lost >= -POINTS and found["minutes"] <= MINUTES
    return [
        ground,
        str(seed),
        f"{teacher['return']:.2f}",
        f"{student['return']:.2f}",
        f"{share:.1%} ({low:.1%} to {high:.1%})",
        f"{teacher['survived']:.1%}",
        f"{student['survived']:.1%}",
        f"{lost:+.1f} ({least:+.1f} to {most:+.1f})",
        f"{student['tracking_error']:.3f}",
        f"{found['minutes']:.1f}",
        f"{found['samples'] / 1000:.0f}",
        verdict(good),
    ]


def verdict(good: bool) -> str:
    """For a table."""
    return "yes" if good else "no"


if __name__ == "__main__":
    main()
