r"""Which obstacles a generalist on Lite3 bodies learns to pass from scratch.

    python studies/parkour.py --seed 1

Trains in runs/studies/lite3-parkour (killed at any moment, the same command goes on), runs 100 bodies that training
has not seen over courses of every kind and size, and writes results/lite3-parkour-from-scratch.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import tyro
from locorl import (
    EvalConfig,
    Evaluation,
    TrainConfig,
    Trainer,
    evaluate,
    find_factory,
    load_policy,
    make_task,
    read_metrics,
    success_by_obstacle,
)
from locorl.evaluation.plots import bodies_figure, save
from study import BODIES, EVALUATION_SEED, MIRRORED, RUNS, markdown_table, on, rate_beside, unseen_bodies, write_results

TASK = make_task("parkour-mixed")
COURSES = len(TASK.terrain.kinds) * TASK.terrain.levels
PROTOCOL = EvalConfig(seconds=20.0, vx=(0.9, 1.0), robots_per_body=COURSES, seed=EVALUATION_SEED)
"""Fast enough for the longest course; one robot of each body on every course."""
RANGE = (0.0, 0.5)
"""Of difficulty: the easier half of the paper's."""
WIDTH = 0.1
"""Of the bins of obstacle size, in hip heights."""


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
    result = evaluate(policy, factory, designs, on(*TASK.terrain.kinds, difficulty=RANGE)(policy.card.task), PROTOCOL)
    minutes = sum(row["seconds"] for row in metrics) / 60.0
    lines = [
        f"lite3, {metrics[-1]['samples'] / 1e6:.1f} M samples from scratch in {minutes:.0f} minutes, beside a bare "
        f"`Batch` of {rate / 1000:.1f} k steps/s. {BODIES} bodies, {COURSES} robots each, one on every course; a "
        "success has reached all waypoints within 20 s. Sizes are in hip heights of the body that meets them.",
        "",
        *markdown_table(("course", "size", "robots", "succeeded", "95 % interval"), success_rows(result)),
        "",
        "![success by body and by obstacle size](bodies.png)",
    ]
    facts = {
        "samples": metrics[-1]["samples"],
        "minutes": minutes,
        "bare_steps_per_second": rate,
        "summary": result.summary(),
        "success": [asdict(each) for each in success_by_obstacle(result, WIDTH)],
    }
    target = write_results("lite3-parkour-from-scratch", lines, facts, (options.seed,))
    save(bodies_figure(result, factory.space.names), target / "bodies.png")
    print("\n".join(lines), f"-> {target}", sep="\n")


def success_rows(result: Evaluation) -> list[tuple[str, ...]]:
    """Course, size in hip heights, robots, share of successes and its interval."""
    rows = []
    for each in success_by_obstacle(result, WIDTH):
        low, high = each.interval
        name, size = each.kind.replace("_", " "), f"{each.low:.1f} to {each.high:.1f}"
        rows.append((name, size, str(each.robots), f"{each.rate:.0%}", f"{low:.0%} to {high:.0%}"))
    return rows


if __name__ == "__main__":
    main()
