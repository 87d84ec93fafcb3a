"""Links between files of the repository as links between pages of the site."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path

LINK = re.compile(r"(!?\[(?:[^\[\]]|\[[^\]]*\])*\])\(([^)\s#]*)(#[^)\s]*)?\)")
"""An inline link or picture: text, target, anchor."""
FENCE = re.compile(r"^ *(```|~~~).*?^ *\1 *$", re.MULTILINE | re.DOTALL)


class Links:
    """Where files of the repository are on the site.

    `docs/` is the site's root; everything else keeps its path. The README of the repository is `overview.md`, as
    the front page is `docs/index.md`.

    Args:
        root: of the repository.
    """

    def __init__(self, root: Path) -> None:
        self._root = root

    def site(self, name: str) -> str:
        """The site's source path of a file of the repository."""
        return "overview.md" if name == "README.md" else name.removeprefix("docs/")

    def repository(self, uri: str) -> str:
        """The file of the repository at a site's source path."""
        if uri == "overview.md":
            return "README.md"
        return f"docs/{uri}" if (self._root / "docs" / uri).exists() else uri

    def assets(self, page: str, text: str) -> Iterator[str]:
        """Files of the repository that a page links to."""
        for found in LINK.finditer(FENCE.sub("", text)):
            target = self._target(page, found[2])
            if target is not None and (self._root / target).is_file():
                yield target

    def rewrite(self, page: str, text: str) -> str:
        """The text of a page with links for the site.

        Args:
            page: of the repository.
            text: its Markdown.

        Raises:
            FileNotFoundError: a link leads nowhere.
        """
        here = posixpath.dirname(self.site(page)) or "."

        def link(found: re.Match[str]) -> str:
            target = self._target(page, found[2])
            if target is None:
                return found[0]
            if not (self._root / target).is_file():
                raise FileNotFoundError(f"{page}: the link to {found[2]} leads nowhere")
            return f"{found[1]}({posixpath.relpath(self.site(target), here)}{found[3] or ''})"

        return outside_code(text, lambda part: LINK.sub(link, part))

    def _target(self, page: str, link: str) -> str | None:
        """The file that a link leads to; of a folder its README. None for other addresses and anchors."""
        if not link or ":" in link:
            return None
        target = posixpath.normpath(posixpath.join(posixpath.dirname(page), link))
        return f"{target}/README.md" if (self._root / target).is_dir() else target


def outside_code(text: str, change: Callable[[str], str]) -> str:
    """Apply a change to everything but fenced blocks of code."""
    parts, end = [], 0
    for fence in FENCE.finditer(text):
        parts += [change(text[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, change(text[end:])])
