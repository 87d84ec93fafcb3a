"""Where a log comes from: versions, commit, machine, time."""

from __future__ import annotations

import json
import platform
import subprocess
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path

PACKAGES = ("legged-deploy", "numpy", "onnxruntime", "mcap", "rosbags", "mujoco")


def provenance() -> dict[str, object]:
    """Facts about this process, as plain types: versions, commit (None if unknown), machine, UTC time."""
    return {
        "versions": {"python": platform.python_version(), **installed(PACKAGES)},
        "commit": commit(),
        "machine": f"{platform.system()} {platform.release()} {platform.machine()}",
        "host": platform.node(),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def installed(names: tuple[str, ...]) -> dict[str, str]:
    """Versions of those distributions that are installed."""
    found: dict[str, str] = {}
    for name in names:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def commit() -> str | None:
    """Commit of this package: as pip recorded it (PEP 610), else of the checkout that it runs from."""
    try:
        origin = json.loads(distribution("legged-deploy").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, json.JSONDecodeError):
        origin = {}
    if recorded := origin.get("vcs_info", {}).get("commit_id"):
        return recorded
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=5, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
