"""`codesign compare`: finished runs side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console


@dataclass(frozen=True)
class Compare:
    """Set finished runs side by side: a table here, and a page with bodies, gains, convergence and students."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Run folders, two or more."""
    out: Path = Path("compare.html")
    """The page."""

    def run(self, console: Console) -> None:
        """Print the table and write the page."""
        from legged_codesign.report.compare import read_runs, summary_table, write_comparison

        runs = read_runs(self.runs)
        console.print(summary_table(runs))
        console.print(str(write_comparison(runs, self.out)), highlight=False, soft_wrap=True)
