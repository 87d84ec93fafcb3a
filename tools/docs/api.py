"""Reference pages from the docstrings, read without importing anything."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import griffe

PACKAGES = {
    "morphgen": "packages/morphgen/src",
    "locorl": "packages/locorl/src",
    "codesign_bo": "packages/codesign_bo/src",
    "distill": "packages/distill/src",
    "deploy": "packages/deploy/src",
    "legged_codesign": "src",
}
"""Folder of each package's source."""
HIDDEN = ("cli", "commands")
"""Modules of the command line, which has pages of its own."""


class Api:
    """The public names of all packages and the pages that show them.

    Args:
        root: of the repository.
    """

    def __init__(self, root: Path) -> None:
        loader = griffe.GriffeLoader(search_paths=[root / folder for folder in PACKAGES.values()])
        self._packages = {name: loader.load(name) for name in PACKAGES}
        loader.resolve_aliases(implicit=True, external=False)

    def canonical(self, name: str) -> str | None:
        """The place of a public name, such as `locorl.env.legged_env.LeggedEnv` for `locorl.LeggedEnv`.

        None if it is shown on no page: a file's name, or a module of the command line.
        """
        head, *rest = name.split(".")
        if rest and rest[0] in HIDDEN:
            return None
        try:
            return _place(self._packages[head], ".".join(rest))
        except (KeyError, griffe.AliasResolutionError):
            return None

    def pages(self) -> dict[str, str]:
        """Markdown of all pages by their path: one for each package, one for each of its modules and folders."""
        pages = {}
        for name, module in self._packages.items():
            pages[f"api/{name}/index.md"] = self._front(name, module)
            for child in _children(module):
                pages[f"api/{name}/{child.name}.md"] = _page(child)
        return pages

    def _front(self, name: str, module: griffe.Object | griffe.Alias) -> str:
        lines = [f"# {name}: API", "", _first(module), ""]
        exported = sorted((str(export) for export in module.exports or ()), key=str.lower)
        if exported:
            lines += [f"`from {name} import ...`", "", "| name | what it is |", "|---|---|"]
            for export in exported:
                place = _place(module, export)
                lines.append(f"| [`{export}`][{place}] | {_first(self._object(place))} |")
        lines += ["", "## Modules", "", "| module | what it knows |", "|---|---|"]
        lines += [f"| [`{name}.{child.name}`]({child.name}.md) | {_first(child)} |" for child in _children(module)]
        return "\n".join(lines) + "\n"

    def _object(self, place: str) -> griffe.Object | griffe.Alias:
        head, _, rest = place.partition(".")
        return self._packages[head][rest]


def _page(module: griffe.Object | griffe.Alias) -> str:
    """Everything public of a module, or of all modules in a folder."""
    parts = [f"# {module.path}\n"]
    for part in _modules(module):
        parts.append(f"::: {part.path}\n")
    return "\n".join(parts)


def _modules(module: griffe.Object | griffe.Alias) -> Iterator[griffe.Object | griffe.Alias]:
    """A module, or the modules in a folder and in those below."""
    yield module
    for child in _children(module):
        yield from _modules(child)


def _place(module: griffe.Object | griffe.Alias, name: str) -> str:
    """Where a name is defined. A function may hide the module of its own name, as `distill.train`."""
    found = module[name]
    if found.is_module and name.rpartition(".")[2] in found.members and name in (module.exports or ()):
        found = found[name]
    return found.canonical_path


def _children(module: griffe.Object | griffe.Alias) -> Iterator[griffe.Object | griffe.Alias]:
    """Public modules and folders of a package, by name."""
    for name, child in sorted(module.modules.items()):
        hidden = name.startswith("_") or (module.parent is None and name in HIDDEN)
        if not hidden and not child.is_alias:
            yield child


def _first(thing: griffe.Object | griffe.Alias) -> str:
    """First paragraph of a docstring, in one line of a table."""
    text = thing.docstring.value.strip() if thing.docstring else ""
    return " ".join(text.split("\n\n")[0].split()).replace("|", "\\|")
