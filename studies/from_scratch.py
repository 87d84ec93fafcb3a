r"""How well, how fast and with how few samples a generalist learns from scratch.

    python studies/from_scratch.py go2-flat --seeds 1 2
    python studies/from_scratch.py go2-flat-long --seeds 1
    python studies/from_scratch.py go2-rough --seeds 1

Trains in runs/studies/<study>/seed-<seed> (killed at any moment, the same command goes on), evaluates snapshots on
100 bodies that training has not seen, and writes results/<study>-from-scratch.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from deploy.page.style import MUTED, figure, label
from locorl import (
    EvalConfig,
    TaskConfig,
    TrainConfig,
    Trainer,
    evaluate,
    find_factory,
    load_policy,
    make_task,
    read_metrics,
)
from locorl.commands.evaluate import to_json
from locorl.evaluation.plots import bodies_figure, save
from locorl.interfaces import BodyFactory
from matplotlib.figure import Figure
from study import (
    EVALUATION_SEED,
    MIRRORED,
    RUNS,
    Snapshots,
    markdown_table,
    on,
    rate_beside,
    unseen_bodies,
    write_results,
)


@dataclass(frozen=True)
class Protocol:
    """One evaluation: a change of the task, and how it is run."""

    change: Callable[[TaskConfig], TaskConfig]
    config: EvalConfig


@dataclass(frozen=True)
class Study:
    """What is trained, how it is judged, and what is asked of it."""

    robot: str
    config: TrainConfig
    protocols: Mapping[str, Protocol]
    every: int
    """Iterations between snapshots."""
    survival: float
    """Share of robots that must not fall, in every protocol."""
    error: float
    """Highest mean tracking error, m/s."""
    decile: float = float("inf")
    """Highest tracking error of the worst decile, m/s."""


def as_it_is(task: TaskConfig) -> TaskConfig:
    """The task of the training."""
    return task


EIGHT_CENTIMETRES = (0.08 - 0.05) / 0.18
"""Difficulty at which steps are 8 cm high."""

GO2_FLAT = Study(
    robot="go2",
    config=TrainConfig(iterations=160, ppo=MIRRORED),
    protocols={"walking": Protocol(as_it_is, EvalConfig(seed=EVALUATION_SEED))},
    every=20,
    survival=0.99,
    error=0.05,
    decile=0.10,
)

STUDIES: Mapping[str, Study] = {
    "go2-flat": GO2_FLAT,
    # until the curve is level, for studies/finetune.py
    "go2-flat-long": replace(GO2_FLAT, config=replace(GO2_FLAT.config, iterations=320), every=80),
    "go2-rough": Study(
        robot="go2",
        config=TrainConfig(iterations=320, task=make_task("locomotion-rough"), ppo=MIRRORED),
        protocols={
            "hills": Protocol(on("hills"), EvalConfig(robots_per_body=2, seed=EVALUATION_SEED)),
            "8 cm steps": Protocol(
                on("steps_up", "steps_down", difficulty=(EIGHT_CENTIMETRES, EIGHT_CENTIMETRES), levels=1),
                EvalConfig(robots_per_body=2, seed=EVALUATION_SEED),
            ),
        },
        every=80,
        survival=0.90,
        error=0.15,
    ),
}


@dataclass(frozen=True)
class Options:
    """Options."""

    study: Annotated[str, tyro.conf.Positional]
    """One of the studies above."""
    seeds: tuple[int, ...] = (1,)
    """Of the trainings."""


def main() -> None:
    """Train, evaluate, record."""
    options = tyro.cli(Options, description=__doc__)
    study = STUDIES[options.study]
    factory = find_factory(study.robot)
    runs = {seed: train(study, factory, RUNS / options.study / f"seed-{seed}", seed) for seed in options.seeds}
    samples = study.config.samples_per_iteration * study.config.iterations
    lines = [f"{study.robot}, {samples / 1e6:.1f} M samples from scratch; {goal(study)}.", ""]
    lines += markdown_table(COLUMNS, [row for seed, run in runs.items() for row in table_rows(seed, run)])
    lines += ["", *(first_good(study, seed, run) for seed, run in runs.items()), ""]
    lines += ["![error and survival while learning](curve.png)", "![bodies](bodies.png)"]
    folder = write_results(
        f"{options.study}-from-scratch", lines, {str(s): run["facts"] for s, run in runs.items()}, options.seeds
    )
    save(curve(study, {seed: run["facts"]["snapshots"] for seed, run in runs.items()}), folder / "curve.png")
    last = runs[options.seeds[-1]]["last"]
    save(bodies_figure(next(iter(last.values())), factory.space.names), folder / "bodies.png")
    print("\n".join(lines), f"-> {folder}", sep="\n")


def train(study: Study, factory: BodyFactory, folder: Path, seed: int) -> dict[str, Any]:
    """One training, or the rest of one, and the evaluation of its snapshots."""
    config = replace(study.config, seed=seed)
    snapshots = Snapshots(folder, study.every)
    rate = rate_beside(folder, factory, config)
    Trainer(factory, config, folder).run(f"{folder.parent.name}, seed {seed}", watchers=[snapshots])
    metrics = {int(row["iteration"]): row for row in read_metrics(folder / "metrics.jsonl")}
    minutes = np.cumsum([row["seconds"] for row in metrics.values()]) / 60.0
    designs = unseen_bodies(factory)
    rows, last = [], {}
    for path in snapshots.paths:
        policy = load_policy(path)
        last = {
            name: evaluate(policy, factory, designs, protocol.change(policy.card.task), protocol.config)
            for name, protocol in study.protocols.items()
        }
        iteration = int(path.stem)
        summaries = {name: result.summary() for name, result in last.items()}
        spent = {"samples": metrics[iteration]["samples"], "minutes": float(minutes[iteration - 1])}
        rows.append({"iteration": iteration, **spent, "protocols": summaries})
    facts = {
        "bare_steps_per_second": rate,
        "snapshots": rows,
        "last": {name: to_json(each) for name, each in last.items()},
    }
    return {"facts": facts, "last": last}


COLUMNS = (
    "seed",
    "protocol",
    "M samples",
    "minutes",
    "survived",
    "error, m/s",
    "worst decile",
    "clearance, cm",
    "slip, %",
    "bare `Batch`, k steps/s",
)


def table_rows(seed: int, run: Mapping[str, Any]) -> list[list[str]]:
    """One row for each protocol, of the last snapshot."""
    facts = run["facts"]
    row = facts["snapshots"][-1]
    return [
        [
            str(seed),
            name,
            f"{row['samples'] / 1e6:.2f}",
            f"{row['minutes']:.1f}",
            f"{summary['survived']:.0f} of {summary['robots']:.0f}",
            f"{summary['tracking_error']:.3f}",
            f"{summary['tracking_error_worst_decile']:.3f}",
            f"{100 * summary['foot_clearance']:.1f}",
            f"{100 * summary['slip']:.1f}",
            f"{facts['bare_steps_per_second'] / 1000:.1f}",
        ]
        for name, summary in row["protocols"].items()
    ]


def goal(study: Study) -> str:
    """What is asked, in words."""
    decile = "" if study.decile == float("inf") else f", worst decile at most {study.decile} m/s"
    return f"asked: {study.survival:.0%} survive, mean error at most {study.error} m/s{decile}"


def good(study: Study, summary: Mapping[str, float]) -> bool:
    """Whether an evaluation is as good as asked."""
    return (
        summary["survived"] >= study.survival * summary["robots"]
        and summary["tracking_error"] <= study.error
        and summary["tracking_error_worst_decile"] <= study.decile
    )


def first_good(study: Study, seed: int, run: Mapping[str, Any]) -> str:
    """When the snapshots are good enough for the first time."""
    for row in run["facts"]["snapshots"]:
        if all(good(study, summary) for summary in row["protocols"].values()):
            return f"Seed {seed} is there after {row['samples'] / 1e6:.2f} M samples, {row['minutes']:.1f} minutes."
    return f"Seed {seed} does not get there."


def curve(study: Study, runs: Mapping[int, Sequence[Mapping[str, Any]]]) -> Figure:
    """Tracking error and survival of the mean action against samples."""
    made, (left, right) = figure(9.2, 3.4, columns=2)
    for name in study.protocols:
        for seed, rows in runs.items():
            x = [row["samples"] / 1e6 for row in rows]
            summaries = [row["protocols"][name] for row in rows]
            left.plot(
                x, [each["tracking_error"] for each in summaries], "o-", markersize=3, label=f"{name}, seed {seed}"
            )
            right.plot(x, [each["survived"] / each["robots"] for each in summaries], "o-", markersize=3)
    left.axhline(study.error, color=MUTED, linewidth=1, linestyle="--")
    right.axhline(study.survival, color=MUTED, linewidth=1, linestyle="--")
    left.set_ylim(bottom=0.0)
    label(left, "environment steps, millions", "mean tracking error, m/s")
    label(right, "environment steps, millions", "share that survived")
    left.legend(frameon=False, fontsize=8.5)
    return made


if __name__ == "__main__":
    main()
