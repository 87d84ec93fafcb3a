"""The one exception that bad designs and unsuitable robots raise."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class MorphologyError(ValueError):
    """A robot description or a design that cannot be used; the message names the element and the remedy."""


@contextmanager
def naming(source: str) -> Iterator[None]:
    """Put the file's name before the message of a MorphologyError."""
    try:
        yield
    except MorphologyError as error:
        if str(error).startswith(source):
            raise
        raise MorphologyError(f"{source}: {error}") from error
