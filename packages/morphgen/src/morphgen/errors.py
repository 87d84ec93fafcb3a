"""The one exception that bad designs and unsuitable robots raise."""

from __future__ import annotations


class MorphologyError(ValueError):
    """A robot description or a design that cannot be used; the message names the element and the remedy."""
