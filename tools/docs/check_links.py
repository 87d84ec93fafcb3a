"""Every link and anchor of a built site leads somewhere, and no page asks another machine for anything.

    python tools/docs/check_links.py site

LinkChecker knows anchors too, but reads a page again for each anchor that is linked to: hours for an API reference.
"""

from __future__ import annotations

import sys
from pathlib import Path
from urllib.parse import unquote, urlsplit

from lxml import html

LOADED = {"script": "src", "img": "src", "link": "href", "source": "src", "iframe": "src", "video": "src"}
"""Elements that a browser loads, and where they say from where."""


def main(site: Path) -> list[str]:
    """What is wrong on a site, one line each.

    Raises:
        FileNotFoundError: there is no site.
    """
    pages = {path: html.parse(str(path)).getroot() for path in sorted(site.rglob("*.html"))}
    if not pages:
        raise FileNotFoundError(f"{site} holds no pages; build them with make docs")
    anchors = {path: {*page.xpath("//@id"), *page.xpath("//a/@name")} for path, page in pages.items()}
    problems = []
    for path, page in pages.items():
        links = {*page.xpath("//a/@href"), *page.xpath("//img/@src"), *page.xpath("//link/@href")}
        links |= set(page.xpath("//script/@src"))
        for link in sorted(links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path.resolve()
            target = target / "index.html" if target.is_dir() else target
            if path.name == "404.html" and parts.path.startswith("/"):
                continue  # it is shown at any depth, so its links start at the site's root
            if not target.is_file():
                problems.append(f"{path}: {link} leads to no file")
            elif parts.fragment and unquote(parts.fragment) not in anchors.get(target, ()):
                problems.append(f"{path}: {link} leads to no anchor")
        for element, attribute in LOADED.items():
            problems += [
                f"{path}: <{element}> is loaded from {url}"
                for url in page.xpath(f"//{element}[not(@rel='canonical')]/@{attribute}")
                if urlsplit(url).netloc
            ]
    return problems


if __name__ == "__main__":
    found = main(Path(sys.argv[1]).resolve())
    print("\n".join(found) or "every link leads somewhere")
    sys.exit(bool(found))
