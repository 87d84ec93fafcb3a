r"""Which obstacles a generalist on Lite3 bodies learns to pass from scratch.

    python studies/parkour.py --seed 1

Trains in runs/studies/lite3-parkour (killed at any moment, the same command goes on), runs 100 bodies that training
has not seen over courses of every kind and size, and writes results/lite3-parkour-from-scratch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import tyro
from locorl import (
    EvalConfig,
    Evaluation,
    TrainConfig,
    Trainer,
    evaluate,
    load_policy,
    make_task,
)
from locorl.commands.evaluate import to_json
from locorl.evaluation.obstacles import success_by_obstacle
from locorl.evaluation.plots import bodies_figure, save
from locorl.providers import find_factory
from locorl.training.metrics import read_metrics
from study import BODIES, EVALUATION_SEED, MIRRORED, RUNS, markdown_table, on, rate_beside, unseen_bodies, write_results

COURSES = {"hurdles": "hurdles", "platforms": "platforms", "long_jump": "gaps", "tilted_stones": "tilted stones"}
"""Kinds of terrain, and what their obstacles are called."""
TASK = make_task("parkour-mixed")
PROTOCOL = EvalConfig(seconds=20.0, vx=(0.9, 1.0), robots_per_body=10, seed=EVALUATION_SEED)
"""Fast enough for the longest course; the robots of a body are spread over the levels."""


@dataclass(frozen=True)
class Options:
    """Options."""

    seed: int = 1
    """Of the training."""
    iterations: int = 800
    """Of the training."""


def main() -> None:
    """Train, evaluate, record."""
    options = tyro.cli(Options, description=__doc__)
    factory, folder = find_factory("lite3"), RUNS / "lite3-parkour"
    config = TrainConfig(iterations=options.iterations, seed=options.seed, task=TASK, ppo=MIRRORED)
    rate = rate_beside(folder, factory, config)
    Trainer(factory, config, folder).run("lite3-parkour")
    metrics = read_metrics(folder / "metrics.jsonl")
    policy, designs = load_policy(folder / "policy.pt"), unseen_bodies(factory)
    results = {}
    for kind in COURSES:
        task = on(kind, difficulty=TASK.terrain.difficulty)(policy.card.task)
        results[kind] = evaluate(policy, factory, designs, task, PROTOCOL)
    minutes = sum(row["seconds"] for row in metrics) / 60.0
    lines = [
        f"lite3, {metrics[-1]['samples'] / 1e6:.1f} M samples from scratch in {minutes:.0f} minutes, beside a bare "
        f"`Batch` of {rate / 1000:.1f} k steps/s. {BODIES} bodies, ten robots each over ten levels of every course; a "
        "success has reached all waypoints within 20 s. Sizes are in hip heights of the body that meets them.",
        "",
        *markdown_table(("course", "size", "robots", "succeeded", "95 % interval"), success_rows(results)),
        "",
        *(f"![{name}]({kind}.png)" for kind, name in COURSES.items()),
    ]
    facts = {
        "samples": metrics[-1]["samples"],
        "minutes": minutes,
        "bare_steps_per_second": rate,
        "courses": {COURSES[kind]: to_json(result) for kind, result in results.items()},
    }
    target = write_results("lite3-parkour-from-scratch", lines, facts, (options.seed,))
    for kind, result in results.items():
        save(bodies_figure(result, factory.space.names), target / f"{kind}.png")
    print("\n".join(lines), f"-> {target}", sep="\n")


def success_rows(results: Mapping[str, Evaluation]) -> list[tuple[str, ...]]:
    """Course, size in hip heights, robots, share of successes and its interval."""
    rows = []
    for kind, result in results.items():
        for each in success_by_obstacle(result, width=0.1):
            low, high = each.interval
            size = f"{each.low:.1f} to {each.high:.1f}"
            rows.append((COURSES[kind], size, str(each.robots), f"{each.rate:.0%}", f"{low:.0%} to {high:.0%}"))
    return rows


if __name__ == "__main__":
    main()
