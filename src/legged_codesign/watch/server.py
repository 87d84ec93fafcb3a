"""The live page: a read-only HTTP server for this machine alone."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from dataclasses import asdict
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any

from legged_codesign.watch.body import Bodies
from legged_codesign.watch.reader import RunReader

HOST = "127.0.0.1"
_FRESH = 1.0
"""Seconds for which a state is shown again, however many pages ask."""
_PAGES = {
    "/": ("page.html", "text/html; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/chart.js": ("chart.js", "text/javascript; charset=utf-8"),
    "/robot.js": ("robot.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
_POLICY = "default-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; frame-ancestors 'none'"
_REPORT_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; media-src data:"
)


class WatchServer(ThreadingHTTPServer):
    """Serves the page of one run folder on 127.0.0.1.

    Nothing but the files of the page, the state of the run, its report and its bodies is served, each under a fixed
    address, so no path of the file system can be asked for.

    Args:
        folder: of the run.
        port: to listen on; 0 takes a free one.

    Raises:
        OSError: the port is in use or may not be used; the message says how to choose another.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, folder: Path, port: int) -> None:
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            raise OSError(
                f"port {port} of {HOST} cannot be used ({error}); choose another with --port, such as "
                f"--port {port + 1 if 1024 <= port < 65_535 else 8080}, or a free one with --port 0"
            ) from error
        self.folder = folder
        self._reader, self._bodies = RunReader(folder), Bodies(folder)
        self._lock = threading.Lock()
        self._state, self._read_at = self._reader.read(), time.monotonic()

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/"

    def state(self) -> bytes:
        """The state of the run as JSON, at most a second old."""
        with self._lock:
            if time.monotonic() - self._read_at > _FRESH:
                self._state, self._read_at = self._reader.read(), time.monotonic()
            return json.dumps(asdict(self._state), allow_nan=False, default=str).encode()

    def body(self, which: str) -> bytes:
        """The triangles of the `best` or the `nominal` body."""
        with self._lock:
            return self._bodies.nominal() if which == "nominal" else self._bodies.of(self._state.best_params)


class _Handler(BaseHTTPRequestHandler):
    server: WatchServer  # pyright: ignore[reportIncompatibleVariableOverride]
    protocol_version = "HTTP/1.1"
    timeout = 60

    def __getattr__(self, name: str) -> Any:
        """Every method but GET and HEAD is refused, also one that nobody has heard of."""
        if name.startswith("do_"):
            return self._refuse
        raise AttributeError(name)

    def do_GET(self) -> None:
        """Answer a page."""
        self._answer()

    def do_HEAD(self) -> None:
        """Answer what GET would, without its body."""
        self._answer()

    def log_message(self, format: str, *args: Any) -> None:
        """Say nothing: the terminal is not for requests."""

    def _refuse(self) -> None:
        self.close_connection = True
        self._send(HTTPStatus.METHOD_NOT_ALLOWED, b"this page can only be read\n", headers={"Allow": "GET, HEAD"})

    def _answer(self) -> None:
        # a foreign site whose name resolves to this machine must not read along
        port = self.server.server_port
        if self.headers.get("Host") not in (f"{HOST}:{port}", f"localhost:{port}"):
            return self._send(HTTPStatus.FORBIDDEN, f"ask for {self.server.url}\n".encode())
        path = self.path.partition("?")[0]
        if path in _PAGES:
            name, kind = _PAGES[path]
            content = (files("legged_codesign.watch") / "page" / name).read_bytes()
            return self._send(HTTPStatus.OK, content, kind, {"Content-Security-Policy": _POLICY})
        if path == "/state.json":
            return self._send(HTTPStatus.OK, self.server.state(), "application/json")
        if path in ("/body/best", "/body/nominal"):
            return self._body(path.rpartition("/")[2])
        if path == "/report.html":
            try:
                content = (self.server.folder / "report.html").read_bytes()
            except OSError:
                return self._send(HTTPStatus.NOT_FOUND, b"there is no report yet\n")
            headers = {"Content-Security-Policy": _REPORT_POLICY}
            return self._send(HTTPStatus.OK, content, "text/html; charset=utf-8", headers)
        return self._send(HTTPStatus.NOT_FOUND, b"there is no such page\n")

    def _body(self, which: str) -> None:
        try:
            content = self.server.body(which)
        except KeyError:
            return self._send(HTTPStatus.NOT_FOUND, b"no body has a score yet\n")
        except (OSError, RuntimeError, ValueError, LookupError) as error:
            return self._send(HTTPStatus.NOT_FOUND, f"the body cannot be drawn: {error}\n".encode())
        return self._send(HTTPStatus.OK, content, "application/octet-stream")

    def _send(
        self,
        status: HTTPStatus,
        content: bytes,
        kind: str = "text/plain; charset=utf-8",
        headers: dict[str, str] | None = None,
    ) -> None:
        tag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
        if status == HTTPStatus.OK and self.headers.get("If-None-Match") == tag:
            status, content = HTTPStatus.NOT_MODIFIED, b""
        self.send_response(status)
        general = {"Cache-Control": "no-cache", "X-Content-Type-Options": "nosniff", "ETag": tag}
        for name, value in {**general, **(headers or {})}.items():
            self.send_header(name, value)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)
