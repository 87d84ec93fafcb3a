"""What `--help` says, for every command and subcommand of the packages."""

from __future__ import annotations

import contextlib
import functools
import importlib
import io
import os
import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
TOOLS = {
    tool: entry
    for file in (ROOT / "pyproject.toml", *sorted(ROOT.glob("packages/*/pyproject.toml")))
    for tool, entry in tomllib.loads(file.read_text(encoding="utf-8"))["project"]["scripts"].items()
    if tool != "codesign_bo"  # the same as codesign-bo
}
"""Entry point of each command."""
COLUMNS = "96"


@functools.cache
def help_text(*command: str) -> str:
    """What `COMMAND --help` prints; empty if there is no such command.

    Args:
        command: name of the tool and of the subcommand.
    """
    module, _, function = TOOLS[command[0]].partition(":")
    main = getattr(importlib.import_module(module), function)
    printed, saved, columns = io.StringIO(), sys.argv, os.environ.get("COLUMNS")
    sys.argv, os.environ["COLUMNS"] = [*command, "--help"], COLUMNS
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(io.StringIO()):
            main()
    except SystemExit:
        pass
    finally:
        sys.argv = saved
        os.environ.pop("COLUMNS")
        if columns is not None:
            os.environ["COLUMNS"] = columns
    return "\n".join(line.rstrip() for line in printed.getvalue().strip().splitlines())


def subcommands(tool: str) -> list[str]:
    """Names of a tool's subcommands."""
    found = re.search(r"\{([\w,-]+)\}", help_text(tool).split("\n\n")[0])
    return found[1].split(",") if found else []


def help_page(tool: str) -> str:
    """A page with the help of a tool and its subcommands."""
    parts = [f"# {tool}\n\nWhat `{tool} --help` prints.\n\n```text\n{help_text(tool)}\n```\n"]
    parts += [f"## {tool} {name}\n\n```text\n{help_text(tool, name)}\n```\n" for name in subcommands(tool)]
    return "\n".join(parts)
