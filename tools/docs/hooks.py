"""MkDocs hooks: READMEs, results and the API join the pages of docs/, and links between them keep working.

Nothing is copied: a page of the site is the file in the repository, and its links are those that work there.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from api import Api
from command_help import TOOLS, help_page
from links import Links, outside_code
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "studies/README.md",
    *sorted(str(p.relative_to(ROOT)) for p in ROOT.glob("packages/*/*.md")),
    "packages/deploy/cpp/README.md",
    *sorted(str(p.relative_to(ROOT)) for p in ROOT.glob("results/*/README.md")),
)
"""Pages that lie outside docs/."""
NAME = re.compile(r"(?<![\[`])`((?:morphgen|locorl|codesign_bo|distill|deploy|legged_codesign)(?:\.\w+)+)`(?!\])")
"""A name of the code in backticks, which is not yet a link."""

_links = Links(ROOT)
_api = Api(ROOT)


def on_files(files: Files, config: MkDocsConfig, **_: Any) -> Files:
    """Add what lies outside docs/: pages, what they link to, the API and the command lines."""
    for name in PAGES:
        _add(files, File.generated(config, _links.site(name), abs_src_path=str(ROOT / name)))
    for page in files.documentation_pages():
        for name in _links.assets(_links.repository(page.src_uri), page.content_string):
            if files.get_file_from_path(_links.site(name)) is None:
                _add(files, File.generated(config, _links.site(name), abs_src_path=str(ROOT / name)))
    for uri, text in _api.pages().items():
        _add(files, File.generated(config, uri, content=text))
    for tool in TOOLS:
        _add(files, File.generated(config, f"commands/{tool}.md", content=help_page(tool)))
    return files


def on_page_markdown(markdown: str, page: Any, files: Files, **_: Any) -> str:
    """Turn links as they are in the repository into those of the site, and names of the code into links."""
    uri = page.file.src_uri
    if uri.startswith(("api/", "commands/")):
        return markdown
    text = _links.rewrite(_links.repository(uri), markdown)

    def link(found: re.Match[str]) -> str:
        name = _api.canonical(found[1])
        return f"[`{found[1]}`][{name}]" if name else found[0]

    return outside_code(text, lambda part: NAME.sub(link, part))


def _add(files: Files, file: File) -> None:
    files.append(file)
