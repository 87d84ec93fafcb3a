"""One page in headless Chromium, driven through the DevTools protocol."""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.request import urlopen

from websockets.sync.client import connect


def find_chromium() -> str | None:
    """The browser's program; None if there is none."""
    return shutil.which("chromium") or shutil.which("google-chrome")


class Browser:
    """A headless browser with one page; WebGL is drawn in software.

    Example:
        with Browser(width=1200, height=800) as browser:
            browser.open("http://localhost:8080")
            Path("page.png").write_bytes(browser.screenshot())
    """

    def __init__(self, *, width: int, height: int, downloads: Path | None = None, timeout: float = 60.0) -> None:
        """Start it.

        Args:
            width: of the page [px].
            height: of the page [px].
            downloads: where the page may save files; None to refuse them.
            timeout: for the start and for each answer [s].
        """
        program = find_chromium()
        if program is None:
            raise FileNotFoundError("Chromium is not installed")
        self._timeout = timeout
        self._calls = 0
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        flags = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--no-first-run", "--mute-audio"]
        flags += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage"]
        flags += [f"--user-data-dir={self._profile.name}", "--remote-debugging-port=0"]
        self._process = subprocess.Popen(
            [program, *flags, f"--window-size={width},{height}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            self._socket = connect(self._page_address(), max_size=None, proxy=None)
            size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self.call("Emulation.setDeviceMetricsOverride", **size)
            if downloads is not None:
                self.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(downloads))
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the browser."""
        self._process.terminate()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._profile.cleanup()

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """The result of a method of the protocol.

        Raises:
            RuntimeError: the browser refused it.
        """
        self._calls += 1
        self._socket.send(json.dumps({"id": self._calls, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(timeout=self._timeout))
            if answer.get("id") != self._calls:
                continue  # an event
            if "error" in answer:
                raise RuntimeError(f"{method}: {answer['error']['message']}")
            return answer["result"]

    def open(self, url: str) -> None:
        """Go to a page and wait until it is loaded."""
        self.call("Page.navigate", url=url)
        self.wait_for("location.href !== 'about:blank' && document.readyState === 'complete'")

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression.

        Raises:
            RuntimeError: it threw.
        """
        result = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in result:
            raise RuntimeError(f"{script}: {result['exceptionDetails']['exception'].get('description')}")
        return result["result"].get("value")

    def wait_for(self, script: str) -> Any:
        """The value of a JavaScript expression once it is true.

        Raises:
            TimeoutError: it stayed false.
        """
        end = time.monotonic() + self._timeout
        while time.monotonic() < end:
            value = self.evaluate(script)
            if value:
                return value
            time.sleep(0.1)
        raise TimeoutError(f"still not true after {self._timeout:g} s: {script}")

    def screenshot(self) -> bytes:
        """A PNG of the page."""
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def _page_address(self) -> str:
        port_file = Path(self._profile.name) / "DevToolsActivePort"
        end = time.monotonic() + self._timeout
        while time.monotonic() < end and self._process.poll() is None:
            # the file appears before it is complete
            lines = port_file.read_text().splitlines() if port_file.exists() else []
            if len(lines) == 2:
                with urlopen(f"http://127.0.0.1:{lines[0]}/json/list") as answer:
                    pages = [target for target in json.load(answer) if target["type"] == "page"]
                if pages:
                    return pages[0]["webSocketDebuggerUrl"]
            time.sleep(0.05)
        raise RuntimeError("Chromium did not start")
