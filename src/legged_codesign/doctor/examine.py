"""All checks in order."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import torch

from legged_codesign.doctor import graphics, machine, software
from legged_codesign.doctor.finding import Finding


@dataclass(frozen=True)
class Probes:
    """Where the doctor looks; a test gives it another machine.

    Attributes:
        cores: cores that may be used, and installed ones.
        torch_threads: threads of torch.
        memory_gb: free memory.
        cgroup: limits of the container.
        mounts: table of mounts.
        run: runs a command.
    """

    cores: Callable[[], tuple[int, int]] = machine.cores
    torch_threads: Callable[[], int] = torch.get_num_threads
    memory_gb: Callable[[], float] = machine.available_gb
    cgroup: Callable[[], machine.Cgroup] = machine.read_cgroup
    mounts: Path = field(default=Path("/proc/self/mounts"))
    run: graphics.Runner = graphics.execute


def examine(folder: Path, probes: Probes | None = None) -> list[Finding]:
    """Examine the machine for runs in `folder`, which need not exist."""
    probes = probes or Probes()
    cgroup = probes.cgroup()
    allowed, installed = probes.cores()
    with ThreadPoolExecutor() as pool:  # these start processes, and mostly wait for them
        gpu = pool.submit(graphics.check_gpu, probes.run)
        opengl = pool.submit(graphics.check_opengl, probes.run)
        ffmpeg = pool.submit(graphics.check_ffmpeg, probes.run)
        return [
            machine.check_cores(allowed, installed, cgroup),
            machine.check_threads(probes.torch_threads(), allowed, os.environ),
            machine.check_memory(probes.memory_gb(), cgroup),
            machine.check_disk(folder),
            machine.check_file_system(folder, probes.mounts),
            gpu.result(),
            opengl.result(),
            ffmpeg.result(),
            software.check_python(),
            *software.check_packages(),
            software.check_robots(),
            *software.check_policies(),
            *software.check_extras(),
        ]
