"""`morphgen view`."""

from __future__ import annotations

import contextlib
import io
import webbrowser
from dataclasses import dataclass
from pathlib import Path

from morphgen.errors import MorphologyError
from morphgen.factory import BodyFactory
from morphgen.robots import load_robot


@dataclass(frozen=True)
class View:
    """Show the robot in the browser with a slider for each design parameter."""

    robot: str = "go2"
    """Built-in robot."""
    urdf: Path | None = None
    """Your own URDF, in place of a built-in robot."""
    port: int = 8080
    """Port of the page; the next free one is taken if it is in use."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets other machines in."""
    open: bool = True
    """Open the page in your browser."""

    def run(self) -> None:
        """Serve the page until Ctrl-C."""
        try:
            import viser

            from morphgen.viewer.page import Page
        except ModuleNotFoundError as error:
            if error.name != "viser":
                raise
            raise MorphologyError("the viewer needs viser: pip install 'legged-morphgen[viewer]'") from error
        factory = self._factory()
        # viser prints a banner of its own
        with contextlib.redirect_stdout(io.StringIO()):
            server = viser.ViserServer(self.host, self.port, verbose=False)
        try:
            page = Page(server, factory)
            url = f"http://{'localhost' if self.host in ('127.0.0.1', '0.0.0.0') else self.host}:{server.get_port()}"
            print(f"{factory.name}: {url} (Ctrl-C ends)", flush=True)
            if self.open:
                webbrowser.open(url)
            page.run()
        except KeyboardInterrupt:
            pass
        finally:
            server.stop()

    def _factory(self) -> BodyFactory:
        if self.urdf is None:
            return load_robot(self.robot)
        return BodyFactory(self.urdf.stem, self.urdf.read_text(encoding="utf-8"), source=str(self.urdf))
