"""`codesign doctor`: is this machine fit for a run?"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape

COLOURS = {"ok": "green", "warn": "yellow", "fail": "red"}


@dataclass(frozen=True)
class Doctor:
    """Examine this machine: cores, memory, GPU, OpenGL, disk, versions, robots, shipped policies.

    Each line says what was found and the way out. Exit status 1 if something fails that a run needs.
    """

    folder: Path = Path("runs")
    """Where runs go; it need not exist."""
    json: bool = False
    """Findings as JSON: topic, status (ok, warn, fail), text, remedy."""

    def run(self, console: Console) -> None:
        """Examine, print, and exit."""
        from legged_codesign.doctor import examine

        findings = examine(self.folder)
        if self.json:
            print(json.dumps([asdict(finding) for finding in findings], indent=1))
        else:
            for found in findings:
                mark = f"[{COLOURS[found.status]}]{found.status:<4}[/]"
                console.print(f"{mark}  {found.topic:<11}  {escape(found.text)}", highlight=False, soft_wrap=True)
                if found.remedy:
                    console.print(f"{'':19}[dim]{escape(found.remedy)}[/dim]", highlight=False, soft_wrap=True)
        sys.exit(any(found.status == "fail" for found in findings))
