"""The errors a user of a study can meet and act upon."""

from __future__ import annotations


class StudyError(RuntimeError):
    """A study cannot go on as asked; the message names the file, the cause and the way out."""


class DivergedError(ValueError):
    """An evaluation gave numbers that are not finite; a study records it as `diverged`."""


class ExecutorError(RuntimeError):
    """Evaluations cannot run any more where they should, and no design is to blame; the message says what to do.

    It ends a run: what was in flight stays open, and comes first in the next run.
    """
