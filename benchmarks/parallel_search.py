"""How much sooner is a search done with trials beside one another, each on a core of its own?

Searches for a Go2 as `make demo` does, with fewer trials, one at a time on one core and then several at a time on one
core each, through Ray's local cluster or this machine's own processes. Both start from the same screened bodies. What
they propose before the Gaussian process must be the same, with the same scores; later the order in which results come
in decides. Prints the wall-clock times of the searches, the start of Ray included, and their ratio (target 1.6).

    pip install -e "packages/codesign_bo[ray]"
    python benchmarks/parallel_search.py
    python benchmarks/parallel_search.py --executor local
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

# not the folder of this file: it has a morphgen.py, which `import morphgen` would find
sys.path[0] = str(Path(__file__).parents[1])

import tyro
from rich.console import Console

from benchmarks.measure import machine
from legged_codesign.config import RunConfig
from legged_codesign.machines import ExecutorName, Machines
from legged_codesign.presets import preset
from legged_codesign.pretrain import pretrain
from legged_codesign.robots import body_factory
from legged_codesign.run_folder import Files
from legged_codesign.search import BodySearch

TARGET = 1.6


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    executor: ExecutorName = "ray"
    workers: int = 2
    trials: int = 12
    initial: int = 8
    """Of these, proposed before the Gaussian process."""
    seed: int = 0


def searched(config: RunConfig, folder: Path, machines: Machines, console: Console) -> tuple[float, list[Any]]:
    """Seconds of the search, and its trial table."""
    files = Files(folder)
    files.training.mkdir(parents=True)
    pretrain(config, files)
    search = BodySearch(config, files, body_factory(config.robot, config.bodies), machines, console)
    search.screen()
    begin = time.perf_counter()
    search.search()
    return time.perf_counter() - begin, json.loads(files.trials.read_text(encoding="utf-8"))


def alike(ours: Any, theirs: Any) -> bool:
    """Whether two trials of different searches are the same."""
    scores = [trial["result"]["mean"] for trial in (ours, theirs)]
    return (ours["params"], ours["seed"]) == (theirs["params"], theirs["seed"]) and abs(scores[0] - scores[1]) < 1e-9


def main() -> None:
    """Search twice, print."""
    options = tyro.cli(Benchmark, description=__doc__)
    config = preset("laptop", "cost-of-transport", "flat")
    search = replace(config.search, trials=options.trials, initial=options.initial)
    config, console = replace(config, seed=options.seed, search=search), Console()
    kinds = {"one at a time": Machines("local", 1, 1), "beside": Machines(options.executor, options.workers, 1)}
    with tempfile.TemporaryDirectory() as folder:
        found = {}
        for name, machines in kinds.items():
            console.print(f"{name}: {machines.executor}, {machines.workers} at a time")
            found[name] = searched(config, Path(folder) / name, machines, console)
    (alone, one), (beside, several) = found.values()
    same = sum(map(alike, one[: options.initial], several[: options.initial]))
    print(f"\n{options.trials} trials, one core each: {alone:.1f} s one at a time,", end=" ")
    print(f"{beside:.1f} s with {options.workers} on {options.executor}: {alone / beside:.2f} times as fast", end=" ")
    print(f"(target {TARGET})")
    print(f"{same} of {options.initial} proposals before the Gaussian process are the same, scores included")
    print(machine())


if __name__ == "__main__":
    main()
