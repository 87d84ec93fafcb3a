"""What a run leaves behind for those who look at it: its log and the stage it is in."""

from __future__ import annotations

import io
import json
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

LOG, PROGRESS = "log.txt", "progress.json"


class LoggedConsole(Console):
    """Prints to a screen, and within `into` the same as plain text into the log of a run folder.

    Args:
        screen: where to print.
    """

    def __init__(self, screen: Console) -> None:
        super().__init__(file=io.StringIO(), width=120, force_terminal=False, no_color=True, highlight=False)
        self._screen, self._logging = screen, False

    def print(self, *objects: Any, **options: Any) -> None:
        """Print on the screen and, with the time, into the log; a log that cannot be written to stops nothing."""
        self._screen.print(*objects, **options)
        if self._logging:
            with suppress(OSError):
                super().print(_now(), end="  ")
                super().print(*objects, **{**options, "soft_wrap": True})

    @contextmanager
    def into(self, folder: Path) -> Iterator[None]:
        """Append all that is printed within to the folder's `log.txt`, with the command and an error that ends it.

        Raises:
            OSError: the log cannot be opened.
        """
        file = (folder / LOG).open("a", encoding="utf-8", buffering=1)

        def note(text: str) -> None:
            with suppress(OSError):
                file.write(f"{_now()}  {text}\n")

        note(f"$ {command_line()}")
        before, self.file, self._logging = self.file, file, True
        try:
            yield
        except KeyboardInterrupt:
            note("stopped by Ctrl-C")
            raise
        except Exception as error:
            note(f"error: {error}")
            raise
        finally:
            self.file, self._logging = before, False
            with suppress(OSError):  # on a full disk what is left to write comes up again
                file.close()


@dataclass(frozen=True)
class Progress:
    """The stage that a run is in, or was in when it ended before its end.

    Attributes:
        stage: its name.
        since: Unix time at which this process began it, s.
        command: command line of the process.
    """

    stage: str
    since: float
    command: str

    @classmethod
    def begin(cls, stage: str) -> Progress:
        """A stage that this process begins now."""
        return cls(stage, time.time(), command_line())

    def to_json(self) -> str:
        """As the text of `stages/progress.json`, which is there only while a stage is unfinished."""
        return json.dumps(asdict(self)) + "\n"

    @classmethod
    def from_json(cls, text: str) -> Progress:
        """From the text that `to_json` wrote."""
        content = json.loads(text)
        return cls(str(content["stage"]), float(content["since"]), str(content["command"]))


def command_line() -> str:
    """The command line of this process, the program without its folder."""
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def _now() -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S")
