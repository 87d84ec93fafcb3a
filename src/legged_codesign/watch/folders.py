"""Where runs lie."""

from __future__ import annotations

from pathlib import Path

RUNS = Path("runs")


def run_folders(home: Path) -> list[Path]:
    """The run folders under `home`, by name, those of several seeds included."""
    found = {path.parent for pattern in ("*/config.yaml", "*/seed-*/config.yaml") for path in home.glob(pattern)}
    return sorted(found)
