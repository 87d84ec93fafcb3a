"""Where a result came from: versions, machine, commit."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = (
    "legged-codesign",
    "legged-morphgen",
    "legged-locorl",
    "legged-codesign-bo",
    "legged-distill",
    "legged-deploy",
)
"""The project's own distributions."""


def provenance() -> dict[str, str]:
    """Versions, processor, cores and, inside a checkout, the commit (with `+changes` if it was edited)."""
    facts = {"python": platform.python_version(), "system": platform.platform(), "processor": _processor()}
    facts["cores"] = str(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count())
    for name in (*PACKAGES, "mujoco", "torch", "numpy"):
        try:
            facts[name] = version(name)
        except PackageNotFoundError:
            continue
    commit = current_commit()
    return facts | ({"commit": commit} if commit else {})


def command_line() -> str:
    """The command that this process was started with."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def described(command: str, seed: object, facts: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Markdown lines that tell how a result was made.

    Args:
        command: makes it again.
        seed: or seeds.
        facts: of the machine that made it; by default this one's.
    """
    facts = facts or provenance()
    return (
        f"- command: `{command}`",
        f"- seed: {seed}",
        f"- commit: {facts.get('commit', 'unknown')}",
        f"- machine: {facts['processor']}, {facts['cores']} cores, {facts['system']}",
        f"- versions: Python {facts['python']}, torch {facts['torch']}, MuJoCo {facts['mujoco']}",
    )


def current_commit() -> str | None:
    """Commit of the checkout that this package runs from, or None outside of one."""
    here = Path(__file__).parent

    def git(*arguments: str) -> str:
        done = subprocess.run(("git", "-C", str(here), *arguments), capture_output=True, text=True, timeout=10)
        return done.stdout.strip() if done.returncode == 0 else ""

    try:
        commit = git("rev-parse", "HEAD")
        tracked = git("ls-files", "--error-unmatch", str(Path(__file__)))
        if not commit or not tracked:
            return None
        return commit + ("+changes" if git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
