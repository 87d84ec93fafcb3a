"""`morphgen view`."""

from __future__ import annotations

import contextlib
import io
import sys
import webbrowser
from dataclasses import dataclass

from morphgen.commands.arguments import RobotArguments, Space, named_space
from morphgen.errors import MorphologyError


@dataclass(frozen=True, kw_only=True)
class View(RobotArguments):
    """Show the robot in the browser with a slider for each design parameter."""

    space: Space = "paper"
    """Sliders: the paper's four scales, eight scales of the single legs, or the wide space."""
    vary: tuple[str, ...] = ()
    """Design parameters by name, in place of a named space."""
    port: int = 8080
    """Port of the page; the next free one is taken if it is in use."""
    host: str = "127.0.0.1"
    """Address to listen on; 0.0.0.0 lets other machines in."""
    open: bool = True
    """Open the page in your browser."""

    def run(self) -> int:
        """Serve the page until Ctrl-C."""
        try:
            import viser

            from morphgen.viewer.page import Page
        except ModuleNotFoundError as error:
            if error.name != "viser":
                raise
            raise MorphologyError("the viewer needs viser: pip install 'legged-morphgen[viewer]'") from error
        factory = self.factory(named_space(self.space, self.vary))
        for note in factory.notes:
            print(note, file=sys.stderr)
        with _quiet():
            server = viser.ViserServer(self.host, self.port, verbose=False)
        with contextlib.suppress(KeyboardInterrupt):  # also while it stops
            try:
                page = Page(server, factory)
                host = "localhost" if self.host in ("127.0.0.1", "0.0.0.0") else self.host
                url = f"http://{host}:{server.get_port()}"
                print(f"{factory.name}: {url} (Ctrl-C ends)", flush=True)
                if self.open:
                    webbrowser.open(url)
                page.run()
            finally:
                with _quiet():
                    server.stop()
        return 0


def _quiet() -> contextlib.redirect_stdout[io.StringIO]:
    """Keeps viser's own announcements off the terminal."""
    return contextlib.redirect_stdout(io.StringIO())
