"""Picture of `morphgen view` for the README, by headless Chromium.

python tools/viewer_screenshot.py docs/viewer.png [front_thigh=1.2 hind_shank=1.3 ...] [-- arguments of `morphgen view`]
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path

from devtools import Browser

WIDTH, HEIGHT = 1280, 800
DESIGN = {"front_thigh": 1.1, "front_shank": 1.2, "hind_thigh": 1.2, "hind_shank": 1.3}

# the page's inputs follow the texts of their labels
SCRIPT = """(async () => {
  const input = label => {
    let node = [...document.querySelectorAll('label, div')].find(e => e.textContent.trim() === label);
    while (!node.querySelector('input')) node = node.parentElement;
    return node.querySelector('input:not([type=hidden])');
  };
  const set = Object.getOwnPropertyDescriptor(HTMLInputElement.prototype, 'value').set;
  for (const [label, value] of Object.entries(%s)) {
    set.call(input(label), value);
    input(label).dispatchEvent(new Event('input', {bubbles: true}));
    await new Promise(done => setTimeout(done, 300));
  }
  input('nominal ghost').click();
  document.querySelectorAll('.mantine-Notification-closeButton').forEach(e => e.click());
})()"""


def main() -> None:
    """Take the picture."""
    arguments, _, options = " ".join(sys.argv[1:]).partition(" -- ")
    target, *pairs = arguments.split()
    design = dict(pair.split("=") for pair in pairs) or {name: str(value) for name, value in DESIGN.items()}
    values = {name.replace("_", " "): value for name, value in design.items()}
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [str(Path(sys.executable).parent / "morphgen"), "view", "--no-open", "--port", str(port)]
    server = subprocess.Popen([*command, *options.split()], stdout=subprocess.PIPE)
    try:
        assert server.stdout is not None
        server.stdout.readline()
        # software rendering shows a new picture every few seconds
        with Browser(width=WIDTH, height=HEIGHT) as browser:
            browser.open(f"http://127.0.0.1:{port}")
            browser.wait_for("document.body.innerText.includes('Dimensions')")
            time.sleep(10)
            browser.evaluate(SCRIPT % values)
            last, picture = b"", browser.screenshot()
            while picture != last:
                time.sleep(5)
                last, picture = picture, browser.screenshot()
            path = Path(target)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(picture)
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
