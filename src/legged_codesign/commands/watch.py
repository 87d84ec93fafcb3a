"""`codesign watch`: a live page of a run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from legged_codesign.stages import RunError, in_use
from legged_codesign.watch.folders import RUNS, run_folders


@dataclass(frozen=True)
class Watch:
    """Show a run as a live page on this machine; nothing in its folder is written. Ctrl-C ends it, not the run."""

    folder: Annotated[Path | None, tyro.conf.Positional] = None
    """Run folder; by default the one under ./runs that a process holds, else the newest."""
    port: int = 8080
    """Of 127.0.0.1; 0 takes a free one."""

    def run(self, console: Console) -> None:
        """Serve until Ctrl-C.

        Raises:
            RunError: the folder holds no run.
            OSError: the port cannot be used.
        """
        from legged_codesign.watch.reader import RunReader
        from legged_codesign.watch.server import WatchServer

        folder = self.folder or _newest()
        state = RunReader(folder).read()
        if state.status == "no run":
            raise RunError(f"{state.words}; start one with `codesign run`, or name another folder")
        with WatchServer(folder, self.port) as server:
            try:
                console.print(f"{folder}: {state.words}", highlight=False, markup=False, soft_wrap=True)
                console.print(
                    f"open {server.url} (Ctrl-C ends this page, not the run)", highlight=False, soft_wrap=True
                )
                server.serve_forever()
            except KeyboardInterrupt:
                console.print("\nthe page is closed; the run is not touched")


def _newest() -> Path:
    folders = run_folders(RUNS)
    if not folders:
        raise RunError(f"there is no run under ./{RUNS}; name a run folder")
    return max(folders, key=lambda folder: (in_use(folder), folder.stat().st_mtime))
