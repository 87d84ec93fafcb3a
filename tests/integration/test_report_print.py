"""The report on A4, as Chromium prints it."""

from __future__ import annotations

import base64
import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))
from devtools import Browser, find_chromium

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_chromium() is None, reason="needs Chromium (Debian: apt install chromium)"),
]

A4_MM = (210.0, 297.0)
MARGINS_MM = (13.0, 14.0)
PX_PER_MM = 96.0 / 25.4


@pytest.fixture(scope="module")
def printed(finished):
    """The report laid out for paper, as wide as the type area of the page."""
    width = round((A4_MM[0] - 2 * MARGINS_MM[0]) * PX_PER_MM)
    with Browser(width=width, height=1200) as browser:
        browser.open((finished.folder / "report.html").as_uri())
        browser.call("Emulation.setEmulatedMedia", media="print")
        yield browser


def test_pages_are_a4(printed) -> None:
    answer = printed.call("Page.printToPDF", preferCSSPageSize=True)
    boxes = re.findall(rb"/MediaBox\s*\[0 0 ([\d.]+) ([\d.]+)\]", base64.b64decode(answer["data"]))
    assert boxes
    for box in boxes:
        assert [float(size) * 25.4 / 72 for size in box] == pytest.approx(A4_MM, abs=0.5)


def test_a_still_takes_the_place_of_the_film(printed) -> None:
    shown = "getComputedStyle(document.querySelector('{}')).display"
    assert printed.evaluate(shown.format("video")) == "none"
    assert printed.evaluate(shown.format("img.still")) == "block"


def test_no_figure_and_no_table_is_cut(printed) -> None:
    """Nothing reaches over the right edge, no figure is higher than a page, and what is folded is open."""
    height = (A4_MM[1] - 2 * MARGINS_MM[1]) * PX_PER_MM
    sizes = printed.evaluate(
        "[...document.querySelectorAll('figure svg, table')].map(e => e.getBoundingClientRect())"
        ".map(b => [b.right, b.width, b.height])"
    )
    width = printed.evaluate("document.documentElement.clientWidth")
    assert len(sizes) > 10
    assert all(right <= width + 1 for right, _, _ in sizes)
    assert all(size[1] > 0 and size[2] > 0 for size in sizes)
    heights = printed.evaluate("[...document.querySelectorAll('figure')].map(e => e.getBoundingClientRect().height)")
    assert max(heights) < height
