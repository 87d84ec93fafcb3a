"""Measures MJX on JAX's CPU backend for `simulators.py`, which calls it with an interpreter that has mujoco-mjx.

    python benchmarks/mjx_worker.py FOLDER

The folder holds `robot.xml` and `work.npz`; prints one line of JSON.
"""

# pyright: reportAttributeAccessIssue=false, reportMissingImports=false
# neither MuJoCo's type stubs nor JAX are there
import json
import os
import sys
import time
from importlib.metadata import version
from pathlib import Path

os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import mujoco
import numpy as np
from mujoco import mjx


def main() -> None:
    """Compile, run, print."""
    folder = Path(sys.argv[1])
    work = np.load(folder / "work.npz")
    model = mujoco.MjModel.from_xml_path(str(folder / "robot.xml"))
    batch = mjx.put_model(model)
    targets = jax.numpy.asarray(work["targets"], dtype=jax.numpy.float32)
    substeps = int(work["substeps"])

    def start(ctrl: jax.Array) -> mjx.Data:
        return mjx.make_data(batch).replace(qpos=jax.numpy.asarray(work["qpos"]), ctrl=ctrl)

    def control_step(data: mjx.Data, ctrl: jax.Array) -> mjx.Data:
        return jax.lax.fori_loop(0, substeps, lambda _, d: mjx.step(batch, d), data.replace(ctrl=ctrl))

    first = jax.vmap(start)(targets[0])
    begin = time.perf_counter()
    step = jax.jit(jax.vmap(control_step)).lower(first, targets[0]).compile()
    compilation = time.perf_counter() - begin

    seconds = []
    data = first
    for _ in range(int(work["runs"]) + 1):
        data = first
        begin = time.perf_counter()
        for target in targets:
            data = step(data, target)
        jax.block_until_ready(data)
        seconds.append(time.perf_counter() - begin)
    result = {
        "seconds": seconds[1:],  # the first run warms up
        "height": float(np.median(data.qpos[:, 2])),
        "compilation": compilation,
        "versions": ", ".join(f"{name} {version(name)}" for name in ("mujoco-mjx", "mujoco", "jax")),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
