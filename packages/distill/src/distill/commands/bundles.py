"""`distill inspect`, `distill verify` and `distill leapp`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from distill.inspection import print_bundle
from distill.leapp import write_leapp
from distill.verify import verify_bundle


@dataclass(frozen=True)
class Verify:
    """Check a bundle: schema, hashes, and every network against the golden trace."""

    bundle: Annotated[Path, tyro.conf.Positional]
    """Folder of the bundle."""

    def run(self, console: Console) -> None:
        """Print what was checked."""
        found = verify_bundle(self.bundle)
        console.print(f"{self.bundle}: schema and {found.files} hashes are right", soft_wrap=True)
        for name, error in found.errors.items():
            console.print(f"  {name}: within {error:.1e} of the golden trace over {found.ticks} ticks")


@dataclass(frozen=True)
class Inspect:
    """Explain a bundle: what robot it is for, what it needs, what it is told and what it gives."""

    bundle: Annotated[Path, tyro.conf.Positional]
    """Folder of the bundle."""

    def run(self, console: Console) -> None:
        """Check it and print what it is."""
        print_bundle(self.bundle, console)


@dataclass(frozen=True)
class Leapp:
    """Describe a bundle in LEAPP's format, which Isaac Lab and Isaac ROS Deploy read (needs the extra `leapp`)."""

    bundle: Annotated[Path, tyro.conf.Positional]
    """Folder of the bundle."""
    out: Annotated[Path, tyro.conf.Positional]
    """Folder of the description and its networks."""

    def run(self, console: Console) -> None:
        """Check the bundle and write the description."""
        console.print(str(write_leapp(self.bundle, self.out)), soft_wrap=True)
