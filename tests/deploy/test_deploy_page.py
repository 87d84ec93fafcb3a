"""The page of a log: one file, nothing from outside, everything that was asked for."""

import base64
import io
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from deploy import DeployError, run
from deploy.cli import main
from deploy.logs.reading import read_log
from deploy.page import figures
from deploy.page.render import write_page
from PIL import Image


class Page(HTMLParser):
    """Headings, sources of embedded files, text, and whether every element is closed."""

    def __init__(self, path):
        super().__init__()
        self.headings, self.sources, self.open, self.words = [], [], [], []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.sources += [value for key, value in attrs if key in ("src", "href", "xlink:href")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)


@pytest.fixture(scope="module")
def seen(seeing_dir, tmp_path_factory):
    """A log of a seeing robot in simulation."""
    path = tmp_path_factory.mktemp("page") / "seen.mcap"
    summary = run(seeing_dir, (0.3, 0.0, 0.0), duration=1.0, log=path)
    assert summary.completed, summary.reason
    return path


def test_page_of_a_seeing_robot(seen, tmp_path):
    page = Page(write_page(seen, tmp_path / "deep" / "page.html", video_seconds=0.0))
    assert page.open == []
    assert page.headings == ["Safety", "Motion", "Joint tracking", "Power", "Timing", "Depth", "Provenance"]
    assert all(source.startswith(("data:", "#")) for source in page.sources)
    text = " ".join(page.words)
    assert "The policy ran for the whole 1 s" in text
    assert "damp: finished" in text
    assert "virtual clock" in text
    log = read_log(seen)
    assert log.info.bundle_sha256 in text
    assert f"{len(log.depth)} images entered the network" in text
    assert not list(tmp_path.rglob("*.partial"))


def test_depth_images_are_drawn_near_bright(seen):
    """A frame that is near in its upper half is brighter there."""
    from deploy.page.style import png

    image = np.full((6, 8), 0.5, np.float32)
    image[:3] = -0.5
    drawn = np.asarray(Image.open(io.BytesIO(png(figures.depth_frames(np.zeros(1), image[None])))).convert("L"))
    dark = np.argwhere(drawn < 40)
    assert dark.size
    top, left, right = dark[:, 0].min(), dark[:, 1].min(), dark[:, 1].max()
    assert drawn[top - 10 : top - 4, left + 4 : right - 4].min() > 200


def test_page_of_a_run_that_a_guard_ended(bundle_dir, fake_robot, tmp_path):
    robot = fake_robot()
    robot.fault = lambda state: replace(state, q=state.q + 9.0) if robot.clock.time > 2_500_000_000 else state
    summary = run(bundle_dir, (0.3, 0.0, 0.0), duration=5.0, log=tmp_path / "a.mcap", robot=robot)
    assert not summary.completed
    text = " ".join(Page(write_page(tmp_path / "a.mcap", tmp_path / "a.html")).words)
    assert f"The run ended early: {summary.reason}" in text
    assert f"damp: {summary.reason}" in text
    assert "No video: the run was not simulated" in text


def test_page_of_a_run_without_control(bundle_dir, fake_robot, tmp_path):
    robot = fake_robot()
    robot.fault = lambda state: replace(state, dq=state.dq * np.nan)
    run(bundle_dir, (0.3, 0.0, 0.0), duration=5.0, log=tmp_path / "a.mcap", robot=robot)
    page = Page(write_page(tmp_path / "a.mcap", tmp_path / "a.html"))
    assert "Power" not in page.headings
    assert "not finite" in " ".join(page.words)


def test_timing_figure_marks_the_99th_percentile(seen):
    trace = read_log(seen).trace
    late = np.zeros(len(trace.time))
    late[: len(late) // 50] = 0.005
    drawn = figures.timing(replace(trace, due=trace.time - late, done=trace.time + 0.001))
    texts = [text.get_text() for ax in drawn.axes for text in ax.texts]
    assert texts == [f"99 %: {np.percentile(late, 99) * 1e3:.2f} ms", "99 %: 1.00 ms"]


def test_names_cannot_break_the_page(folder, tmp_path):
    folder.manifest["name"] = "<script>alert(1)</script>"
    run(folder.seal(), (0.3, 0.0, 0.0), duration=0.1, log=tmp_path / "a.mcap")
    text = write_page(tmp_path / "a.mcap", tmp_path / "a.html", video_seconds=0.0).read_text()
    assert "<script" not in text
    assert "&lt;script&gt;" in text


def test_page_that_cannot_be_written(seen, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DeployError, match="cannot write the page"):
        write_page(seen, tmp_path / "file" / "page.html", video_seconds=0.0)


def test_without_matplotlib_the_extra_is_named(seen, tmp_path):
    """And the rest of the command line works."""
    script = (
        "import sys, importlib.util\n"
        "real = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *rest: None if name == 'matplotlib' else real(name, *rest)\n"
        "sys.modules['matplotlib'] = None\n"
        "from deploy.cli import main\n"
        "main(sys.argv[1:])\n"
    )

    def deploy(*args):
        return subprocess.run([sys.executable, "-c", script, *map(str, args)], capture_output=True, text=True)

    assert deploy("energy", seen).returncode == 0
    refused = deploy("page", seen, "-o", tmp_path / "page.html")
    assert refused.returncode == 1
    assert "pip install 'legged-deploy[plot]'" in refused.stderr


@pytest.mark.slow
def test_video_from_ground_truth(bundle_dir, tmp_path, capsys):
    """Drawn frames differ from each other and from an empty sky; needs some OpenGL."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    run(bundle_dir, (0.3, 0.0, 0.0), duration=1.0, log=tmp_path / "a.mcap")
    main(["page", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "a.html"), "--video", "0.6"])
    text = (tmp_path / "a.html").read_text()
    found = re.search(r"data:video/mp4;base64,([^\"]+)", text)
    if not found and "could not draw" in text:
        pytest.skip("no OpenGL here")
    assert found
    (tmp_path / "a.mp4").write_bytes(base64.b64decode(found[1]))
    reader = imageio_ffmpeg.read_frames(str(tmp_path / "a.mp4"))
    meta = next(reader)
    frames = [np.frombuffer(frame, np.uint8).astype(int) for frame in reader]
    assert meta["size"] == (640, 360)
    assert len(frames) == 15
    assert np.abs(frames[-1] - frames[0]).max() > 50
