r"""How close a short fine-tune of the generalist comes to training from scratch on one body.

    python studies/from_scratch.py go2-flat --seeds 1
    python studies/finetune.py go2-flat

For three bodies and two seeds each: fine-tunes the generalist of a study of from_scratch.py for a fifteenth of its
iterations, trains from scratch for all of them, and evaluates both and the generalist on the same commands and
starts. Works in runs/studies/<study>-finetune (killed at any moment, the same command goes on) and writes
results/<study>-finetune.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated

import numpy as np
import tyro
from deploy.page.style import ACCENT, BEST, NOMINAL, figure, label
from from_scratch import STUDIES
from locorl import (
    EvalConfig,
    Evaluation,
    FinetuneConfig,
    TrainConfig,
    Trainer,
    evaluate,
    find_factory,
    finetune,
    gains,
    load_policy,
    read_metrics,
    repeat_design,
)
from locorl.evaluation.plots import save
from locorl.interfaces import Array, BodyFactory
from matplotlib.figure import Figure
from study import MIRRORED, RUNS, markdown_table, write_results

BODIES = ((1.0, 1.0, 1.0, 1.0), (0.6, 1.4, 0.6, 1.4), (1.4, 1.4, 0.6, 0.6))
"""Front thigh, front shank, hind thigh, hind shank."""
PROTOCOL = EvalConfig(robots_per_body=100, reset_joint=0.1, seed=4242)
SHARE = 1 / 15
"""Of the pre-training's iterations (section IV-C: 6.67 %)."""
FINE_TUNING = replace(MIRRORED, learning_rate=3e-4, desired_kl=0.02, epochs=15, minibatches=8, entropy=0.0)
"""Many small steps on each rollout: so short a training is poor in samples, not in time. Chosen with another seed
and other evaluations than those reported."""
POLICIES = {"generalist": NOMINAL, "fine-tuned": ACCENT, "from scratch": BEST}


@dataclass(frozen=True)
class Options:
    """Options."""

    study: Annotated[str, tyro.conf.Positional] = "go2-flat"
    """The study of from_scratch.py whose first generalist is fine-tuned."""
    seeds: tuple[int, ...] = (1, 2)
    """Of the trainings on one body."""
    protocol: EvalConfig = field(default_factory=lambda: PROTOCOL)
    """The evaluation that is reported."""


@dataclass(frozen=True)
class Case:
    """One body and seed: the three policies' evaluations, and the rewards while they learnt."""

    body: tuple[float, ...]
    seed: int
    results: Mapping[str, Evaluation]
    curves: Mapping[str, Sequence[Mapping[str, float]]]
    kept: int
    """Iteration of the fine-tune whose policy was the best, chosen on other robots; 0 is the generalist."""


def main() -> None:
    """Train, evaluate, record."""
    options = tyro.cli(Options, description=__doc__)
    study = STUDIES[options.study]
    factory = find_factory(study.robot)
    cases = [run(factory, study.config, options, body, seed) for body in BODIES for seed in options.seeds]
    rows = [table_row(case) for case in cases]
    ratios = {body: ratio(returns(cases, body, "fine-tuned"), returns(cases, body, "from scratch")) for body in BODIES}
    iterations = study.config.iterations
    lines = [
        f"From scratch: {iterations} iterations on the one body; fine-tuned: at most {int(iterations * SHARE)} from "
        f"the generalist, with {FINE_TUNING.epochs} passes over each rollout in {FINE_TUNING.minibatches} minibatches "
        f"(from scratch: {MIRRORED.epochs} in {MIRRORED.minibatches}). Undiscounted return of 20 s "
        "(eq. 9) of 100 robots with the same commands and starts.",
        "",
        *markdown_table(COLUMNS, rows),
        "",
        *markdown_table(
            ("body", "return of fine-tuned / from scratch", "95 % interval"),
            [
                (name(body), f"{100 * m:.1f} %", f"{100 * a:.1f} to {100 * b:.1f} %")
                for body, (m, a, b) in ratios.items()
            ],
        ),
        "",
        "The intervals are bootstraps over the robots, paired, of both seeds.",
        "",
        "![learning curves](curves.png)",
    ]
    facts = {
        "fine_tuning": asdict(FINE_TUNING),
        "ratios": {name(body): value for body, value in ratios.items()},
        "cases": [
            {
                "body": case.body,
                "seed": case.seed,
                "kept": case.kept,
                "summaries": {which: result.summary() for which, result in case.results.items()},
                "returns": {which: result.returns[0] for which, result in case.results.items()},
            }
            for case in cases
        ],
    }
    folder = write_results(f"{options.study}-finetune", lines, facts, options.seeds)
    save(curves(cases), folder / "curves.png")
    print("\n".join(lines), f"-> {folder}", sep="\n")


def run(factory: BodyFactory, full: TrainConfig, options: Options, body: tuple[float, ...], seed: int) -> Case:
    """One body and seed; `full` is the training from scratch."""
    generalist = RUNS / options.study / "seed-1" / "policy.pt"
    folder = RUNS / f"{options.study}-finetune" / f"{'-'.join(map(str, body))}-seed-{seed}"
    design, train = np.array(body), replace(full, seed=seed)
    config = FinetuneConfig(
        num_envs=train.num_envs,
        iterations=int(train.iterations * SHARE),
        ppo=FINE_TUNING,
        evaluate_every=5,
        keep_best=True,
    )
    tuned = finetune(generalist, factory, design, config, seed, folder / "tuned", quiet=False)
    scratch = Trainer(factory, train, folder / "scratch", designs=repeat_design(factory, design, train.num_envs))
    scratch.run(f"{name(body)}, seed {seed}")
    policies = {
        "generalist": load_policy(generalist),
        "fine-tuned": tuned.policy,
        "from scratch": scratch.policy(),
    }
    task = train.task
    results = {
        which: evaluate(policy, factory, design[None], task, options.protocol) for which, policy in policies.items()
    }
    scratch_curve = read_metrics(folder / "scratch" / "metrics.jsonl")
    return Case(body, seed, results, {"fine-tuned": tuned.curve, "from scratch": scratch_curve}, tuned.iteration)


def name(body: tuple[float, ...]) -> str:
    """A body as a tuple of scales."""
    return f"({', '.join(f'{scale:g}' for scale in body)})"


def returns(cases: Sequence[Case], body: tuple[float, ...], which: str) -> Array:
    """Of one kind of policy on one body, (seeds, robots)."""
    return np.stack([case.results[which].returns[0] for case in cases if case.body == body])


def ratio(ours: Array, theirs: Array, draws: int = 10_000) -> tuple[float, float, float]:
    """Ratio of mean returns (seeds, robots), and the bounds of its 95 % interval."""
    rng = np.random.default_rng(0)
    # a robot has the same command in all runs, so it is drawn with all of them
    index = rng.integers(ours.shape[1], size=(draws, ours.shape[1]))
    a, b = (each.mean(axis=0)[index].mean(axis=1) for each in (ours, theirs))
    low, high = np.percentile(a / b, (2.5, 97.5))
    return float(ours.mean() / theirs.mean()), float(low), float(high)


COLUMNS = (
    "body",
    "seed",
    *(f"return, {which}" for which in POLICIES),
    "fine-tuned - generalist, robot by robot",
    *(f"error, {which}, m/s" for which in POLICIES),
    "survived",
    "kept iteration",
)


def table_row(case: Case) -> list[str]:
    """Returns with standard errors, tracking errors, survivors of each policy."""
    gain = gains(case.results["generalist"], case.results["fine-tuned"])["returns"].difference
    earned = (case.results[which].returns[0] for which in POLICIES)
    return [
        name(case.body),
        str(case.seed),
        *(f"{each.mean():.2f} ± {each.std(ddof=1) / np.sqrt(len(each)):.2f}" for each in earned),
        f"{gain.mean:+.2f} ± {gain.sem:.2f}",
        *(f"{case.results[which].tracking_error.mean():.3f}" for which in POLICIES),
        " / ".join(str(int(case.results[which].survived.sum())) for which in POLICIES),
        str(case.kept),
    ]


def curves(cases: Sequence[Case]) -> Figure:
    """Reward while training on each body, from scratch and from the generalist."""
    made, axes = figure(11.0, 3.3, columns=len(BODIES))
    for ax, body in zip(axes, BODIES, strict=True):
        for case in (case for case in cases if case.body == body):
            for which, rows in case.curves.items():
                label_once = which if case.seed == cases[0].seed else None
                samples = [row["samples"] / 1e6 for row in rows]
                ax.plot(
                    samples, [row["reward"] for row in rows], color=POLICIES[which], linewidth=1.4, label=label_once
                )
        label(ax, "environment steps, millions", "reward per second", name(body))
        ax.legend(frameon=False, fontsize=8.5)
    return made


if __name__ == "__main__":
    main()
