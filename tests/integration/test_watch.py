"""`codesign watch`: its server over HTTP, its triangles, and its page in a browser."""

from __future__ import annotations

import http.client
import io
import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from morphgen.views.scene import body_scene
from PIL import Image

from legged_codesign.presets import preset
from legged_codesign.run_folder import bind
from legged_codesign.watch.body import CORNER, triangles
from legged_codesign.watch.server import WatchServer

sys.path.insert(0, str(Path(__file__).parents[2] / "tools"))  # the browser's driver

Codesign = Callable[..., tuple[int, str]]


@contextmanager
def serving(folder: Path) -> Iterator[WatchServer]:
    with WatchServer(folder, 0) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


def ask(server: WatchServer, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes, Any]:
    connection = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=30)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, content, answer.headers


@pytest.fixture
def server(hand_made: Any) -> Iterator[WatchServer]:
    hand_made.finish("pretrain", "screen")
    hand_made.enter("search")
    hand_made.search(0.30, 0.20)
    (hand_made.folder / "secret.txt").write_text("secret")
    with serving(hand_made.folder) as server:
        yield server


def test_it_listens_on_this_machine_alone(server: WatchServer) -> None:
    assert server.server_address[0] == "127.0.0.1"


def test_the_state_as_json(server: WatchServer) -> None:
    status, content, headers = ask(server, "/state.json")
    state = json.loads(content)
    assert status == 200
    assert headers["Content-Type"] == "application/json"
    assert [trial["score"] for trial in state["trials"]] == [0.30, 0.20]
    assert state["best"] == 1
    assert state["status"] == "stopped"


def test_the_page_needs_nothing_from_elsewhere(server: WatchServer) -> None:
    status, content, headers = ask(server, "/")
    assert status == 200
    assert "default-src 'self'" in headers["Content-Security-Policy"]
    page = content.decode()
    names = re.findall(r'(?:src|href)="([^"]+)"', page)
    scripts = [ask(server, f"/{name}")[1].decode() for name in names if name.endswith((".js", ".css"))]
    assert len(scripts) == 2
    for name in re.findall(r'from "\./([^"]+)"', scripts[-1] + scripts[0]):
        status, content, _ = ask(server, f"/{name}")
        assert status == 200
        scripts.append(content.decode())
    assert len(scripts) == 4
    for text in (page, *scripts):
        assert not re.findall(r"https?://(?!www\.w3\.org/2000/svg)", text)


def test_head_has_no_body(server: WatchServer) -> None:
    status, content, headers = ask(server, "/state.json", "HEAD")
    assert (status, content) == (200, b"")
    assert int(headers["Content-Length"]) > 100


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS", "BREW"])
def test_other_methods_are_refused(method: str, server: WatchServer) -> None:
    status, _, headers = ask(server, "/state.json", method)
    assert status == 405
    assert headers["Allow"] == "GET, HEAD"


@pytest.mark.parametrize(
    "path",
    [
        "/secret.txt",
        "/../secret.txt",
        "/..%2f..%2fetc/passwd",
        "//etc/passwd",
        "/page/../secret.txt",
        "/study.sqlite",
        "/config.yaml",
        "/body/../secret.txt",
        "/body/other",
        "/server.py",
    ],
)
def test_no_other_file_is_served(path: str, server: WatchServer) -> None:
    status, content, _ = ask(server, path)
    assert status == 404
    assert b"secret" not in content


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1:1", "localhost", ""])
def test_a_foreign_name_of_this_machine_is_refused(host: str, server: WatchServer) -> None:
    assert ask(server, "/state.json", Host=host)[0] == 403


def test_localhost_is_this_machine(server: WatchServer) -> None:
    assert ask(server, "/state.json", Host=f"localhost:{server.server_port}")[0] == 200


def test_the_report_once_there_is_one(server: WatchServer, hand_made: Any) -> None:
    assert ask(server, "/report.html")[0] == 404
    (hand_made.folder / "report.html").write_text("<h1>done</h1>")
    status, content, _ = ask(server, "/report.html")
    assert (status, content) == (200, b"<h1>done</h1>")


def test_a_folder_that_vanishes(server: WatchServer, hand_made: Any) -> None:
    shutil.rmtree(hand_made.folder)
    server._read_at = 0.0
    state = json.loads(ask(server, "/state.json")[1])
    assert state["status"] == "no run"
    assert ask(server, "/body/best")[0] == 404


def test_what_is_unchanged_is_not_sent_again(server: WatchServer) -> None:
    tag = ask(server, "/page.js")[2]["ETag"]
    status, content, _ = ask(server, "/page.js", **{"If-None-Match": tag})
    assert (status, content) == (304, b"")


def test_a_port_in_use(hand_made: Any, codesign: Codesign) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        code, output = codesign("watch", hand_made.folder, "--port", str(port))
    assert code == 1
    assert f"port {port}" in output
    assert "--port 0" in output
    assert codesign("watch", hand_made.folder, "--port", "70000")[0] == 1


def test_triangles_are_those_of_the_scene(go2: Any, design: np.ndarray) -> None:
    scene = body_scene(go2, design)
    corners = np.frombuffer(triangles(scene), CORNER)
    assert len(corners) == 3 * sum(len(mesh.faces) for mesh in scene.geometry.values())
    low, high = scene.bounds
    np.testing.assert_allclose(corners["position"].min(axis=0), low, atol=1e-6)
    np.testing.assert_allclose(corners["position"].max(axis=0), high, atol=1e-6)
    assert set(np.unique(corners["color"][:, 3])) == {255}


@pytest.mark.slow
def test_ctrl_c_ends_the_page(hand_made: Any) -> None:
    command = [sys.executable, "-c", "from legged_codesign.cli import main; main()", "watch", hand_made.folder]
    with subprocess.Popen([*command, "--port", "0"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        assert "http://127.0.0.1:" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        rest, _ = process.communicate(timeout=60)
    assert "the run is not touched" in rest
    assert process.returncode == 0


@pytest.mark.slow
@pytest.mark.skipif(not (shutil.which("chromium") or shutil.which("google-chrome")), reason="Chromium is not installed")
def test_the_page_in_a_browser(hand_made: Any, snapshot: Callable) -> None:
    from devtools import Browser

    folder = hand_made.folder
    (folder / "config.yaml").unlink()
    bind(folder, preset("smoke"))  # names a robot that can be drawn
    hand_made.finish("pretrain", "screen")
    hand_made.enter("search")
    hand_made.search(0.30)
    before = snapshot(folder)
    rows = "document.querySelectorAll('#trials td:first-child').length"
    with serving(folder) as server, Browser(width=1200, height=1800) as browser:
        browser.open(server.url)
        browser.wait_for(f"{rows} === 1")
        assert "killed, stopped or failed in stage 3 of 9" in browser.evaluate("document.body.innerText")
        browser.wait_for("document.getElementById('body-note').textContent.startsWith('Body 0')")
        box = browser.evaluate("JSON.stringify(document.getElementById('robot').getBoundingClientRect())")
        assert _colours(browser.screenshot(), json.loads(box)) > 5, "a shaded robot, not an empty canvas"
        assert snapshot(folder) == before
        assert sorted(path.name for path in folder.glob("study*")) == ["study.sqlite", "study.sqlite.lock"]
        hand_made.search(0.20)
        browser.wait_for(f"{rows} === 2")
        browser.wait_for("document.getElementById('body-note').textContent.includes('0.2000')")
        assert browser.evaluate("document.querySelectorAll('#convergence circle').length") == 2
        assert browser.evaluate("document.getElementById('report').hidden") is True
        (folder / "report.html").write_text("<h1>done</h1>")
        browser.wait_for("!document.getElementById('report').hidden")
        assert browser.evaluate("document.getElementById('lost').hidden") is True


def _colours(picture: bytes, box: dict[str, float]) -> int:
    """Number of distinct colours in a rectangle of a screenshot."""
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    part = image.crop((int(box["left"]) + 2, int(box["top"]) + 2, int(box["right"]) - 2, int(box["bottom"]) - 2))
    return len(np.unique(np.asarray(part).reshape(-1, 3), axis=0))
