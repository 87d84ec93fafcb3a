"""The computer: cores, threads, memory, disk and the file system of the run folder."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import psutil
from codesign_bo.storage.filesystem import network_mount
from locorl.simulation.cpu import available_cores

from legged_codesign.doctor.finding import Finding

GB = 1e9
LEAST_MEMORY, GOOD_MEMORY = 1.5, 4.0
"""Free memory that a run of the `laptop` preset needs (it takes about 1 GB), and with which larger ones start, GB."""
LEAST_DISK, GOOD_DISK = 0.5, 5.0
"""Free disk that one run needs, and that a few runs with films need, GB."""
THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


@dataclass(frozen=True)
class Cgroup:
    """Limits of the container that this process lives in; None where there is none.

    Attributes:
        cores: processor time per time.
        memory_gb: memory that is left below the limit.
    """

    cores: float | None = None
    memory_gb: float | None = None


def read_cgroup(root: Path = Path("/sys/fs/cgroup"), own: Path = Path("/proc/self/cgroup")) -> Cgroup:
    """The tightest limits of this process's control group (version 2) and of those around it."""
    try:
        line = next(text for text in own.read_text().splitlines() if text.startswith("0::"))
    except (OSError, StopIteration):
        return Cgroup()
    group = root / line.removeprefix("0::").lstrip("/")
    cores, memory = [], []
    while group.is_relative_to(root):
        quota, _, period = _word(group / "cpu.max").partition(" ")
        if quota.isdecimal() and period.strip().isdecimal():
            cores.append(int(quota) / int(period))
        limit, used = _word(group / "memory.max"), _word(group / "memory.current")
        if limit.isdecimal() and used.isdecimal():
            memory.append((int(limit) - int(used)) / GB)
        group = group.parent
    return Cgroup(min(cores, default=None), min(memory, default=None))


def _word(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


def check_cores(allowed: int, installed: int, cgroup: Cgroup) -> Finding:
    """How many cores a run gets.

    Args:
        allowed: cores that this process may use.
        installed: cores of the machine.
        cgroup: limits of the container.
    """
    if cgroup.cores is not None and cgroup.cores < allowed:
        return Finding(
            "cores",
            "warn",
            f"this process sees {allowed} cores, but its container gets the time of {cgroup.cores:g}",
            f"start it with taskset -c 0-{max(1, round(cgroup.cores)) - 1}, or raise the container's CPU limit: "
            "threads beyond the limit wait for one another",
        )
    text = f"{allowed} of {installed} cores may be used"
    if allowed < 2:
        return Finding("cores", "warn", text, "minutes are stated for 2 cores; expect twice as long")
    return Finding("cores", "ok", text)


def check_threads(torch_threads: int, cores: int, environment: Mapping[str, str]) -> Finding:
    """Whether torch uses the cores that there are."""
    settings = ", ".join(f"{name}={environment[name]}" for name in THREADS if name in environment)
    text = f"torch uses {torch_threads} threads on {cores} cores" + (f" ({settings})" if settings else "")
    if torch_threads > cores:
        return Finding("threads", "warn", text, f"set OMP_NUM_THREADS={cores}: more threads than cores slow training")
    if torch_threads < cores / 2:
        return Finding("threads", "warn", text, f"unset OMP_NUM_THREADS or set it to {cores}: most cores stay idle")
    return Finding("threads", "ok", text)


def check_memory(available_gb: float, cgroup: Cgroup) -> Finding:
    """Whether a run fits into memory."""
    limited = cgroup.memory_gb is not None and cgroup.memory_gb < available_gb
    free = cgroup.memory_gb if limited and cgroup.memory_gb is not None else available_gb
    text = f"{free:.1f} GB free" + (" below the container's limit" if limited else "")
    way_out = "raise the container's memory limit" if limited else "end other programs"
    if free < LEAST_MEMORY:
        return Finding("memory", "fail", text, f"a run needs {LEAST_MEMORY:g} GB: {way_out}")
    if free < GOOD_MEMORY:
        return Finding("memory", "warn", text, f"enough for the laptop preset, not for larger ones: {way_out}")
    return Finding("memory", "ok", text)


def check_disk(folder: Path, free_gb: float | None = None, writable: bool | None = None) -> Finding:
    """Whether runs can be written to a folder, which need not exist.

    Args:
        folder: where runs go.
        free_gb: free space there; None to measure it.
        writable: whether it can be written to; None to try.
    """
    there = folder.resolve()
    while not there.exists():
        there = there.parent
    if writable is None:
        writable = there.is_dir() and os.access(there, os.W_OK)
    if not writable:
        return Finding("disk", "fail", f"{folder} cannot be written to", "choose another folder with --folder")
    free = shutil.disk_usage(there).free / GB if free_gb is None else free_gb
    text = f"{free:.1f} GB free for {folder}"
    if free < LEAST_DISK:
        return Finding("disk", "fail", text, f"a run needs {LEAST_DISK:g} GB: delete old runs or choose --folder")
    if free < GOOD_DISK:
        return Finding("disk", "warn", text, "enough for one run; delete old ones before the next")
    return Finding("disk", "ok", text)


def check_file_system(folder: Path, mounts: Path = Path("/proc/self/mounts")) -> Finding:
    """Whether the study of a run may lie in a folder: SQLite needs a local disk."""
    found = network_mount(folder, mounts)
    if found is not None:
        text = f"{folder} lies on a network file system ({found})"
        return Finding(
            "file system",
            "fail",
            text,
            "SQLite may lose trials there: give the run a --study on a local disk, or another --folder",
        )
    return Finding("file system", "ok", f"{folder} is on no network file system")


def available_gb() -> float:
    """Memory that can be had without swapping, GB."""
    return psutil.virtual_memory().available / GB


def cores() -> tuple[int, int]:
    """Cores that this process may use, and cores of the machine."""
    return available_cores(), os.cpu_count() or 1
