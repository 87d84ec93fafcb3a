"""How much faster are 4096 Go2 bodies as a BodyBatch than as 4096 URDFs, written, parsed and compiled one by one?

A BodyBatch holds all that a simulator needs: the MjModel fields of every body, its stance, the targets that hold it,
gains and limits. The peer writes the URDF of a body to a file, lets MuJoCo parse it, adds the free joint and compiles;
it finds no stance. The peer handles a random subset, in chunks between the batches, and is scaled up to all bodies.
Targets: 50 times as fast, and under 2 s on 2 cores.

    python benchmarks/morphgen.py
"""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

# the folder of this file, where `import morphgen` would find this file
sys.path = [folder for folder in sys.path if Path(folder) != Path(__file__).parent]

import mujoco
import numpy as np
import tyro
from morphgen import BodyFactory, go2

from legged_codesign.provenance import provenance


@dataclass(frozen=True)
class Benchmark:
    """Options."""

    bodies: int = 4096
    subset: int = 256
    """Bodies that the peer makes."""
    runs: int = 8
    """Batches, each followed by a chunk of the subset."""
    seed: int = 0


def batch_seconds(factory: BodyFactory, designs: np.ndarray) -> float:
    """Time of one BodyBatch."""
    start = time.perf_counter()
    batch = factory.batch(designs)
    elapsed = time.perf_counter() - start
    assert batch.stance_qpos.shape == (len(designs), batch.model.nq)
    return elapsed


def peer_seconds(factory: BodyFactory, designs: np.ndarray, folder: Path) -> np.ndarray:
    """Times of writing and of compiling, (2,), for these designs."""
    spent = np.zeros(2)
    path = folder / "body.urdf"
    for design in designs:
        start = time.perf_counter()
        path.write_text(factory.urdf(design), encoding="utf-8")
        written = time.perf_counter()
        spec = mujoco.MjSpec.from_file(str(path))
        spec.body(factory.layout.base).add_freejoint()
        model = spec.compile()
        spent += written - start, time.perf_counter() - written
        assert model.nv == 18
    return spent


def main() -> None:
    """Measure and print."""
    options = tyro.cli(Benchmark, description=__doc__)
    rng = np.random.default_rng(options.seed)
    factory = go2()
    designs = factory.space.sample(options.bodies, rng)
    subset = designs[rng.choice(options.bodies, min(options.subset, options.bodies), replace=False)]
    batch_seconds(factory, designs[:8])  # first-call costs are not the subject
    batches, peer = [], np.zeros(2)
    with tempfile.TemporaryDirectory() as folder:
        peer_seconds(factory, subset[:2], Path(folder))
        for chunk in np.array_split(subset, options.runs):
            batches.append(batch_seconds(factory, designs))
            peer += peer_seconds(factory, chunk, Path(folder))
    ours = float(np.median(batches))
    writing, compiling = peer * options.bodies / len(subset)
    print(f"{options.bodies} bodies of {factory.name}")
    print(f"BodyBatch          {ours:8.3f} s  ({min(batches):.3f} to {max(batches):.3f} in {options.runs} runs)")
    print(f"URDFs, one by one  {writing + compiling:8.1f} s  (from {len(subset)}: {writing:.1f} s to write them with")
    print(f"                              morphgen, {compiling:.1f} s to parse and compile them with MuJoCo)")
    print(f"ratio              {(writing + compiling) / ours:8.1f}  ({compiling / ours:.1f} without the writing)")
    facts = provenance()
    print(", ".join(f"{name} {facts[name]}" for name in ("processor", "cores", "mujoco", "commit") if name in facts))


if __name__ == "__main__":
    main()
