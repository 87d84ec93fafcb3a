"""Find environments and teachers of other packages by their entry points."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TypeAlias, cast

from distill.errors import ProviderError
from distill.interfaces import StudentEnv, Teacher

ENVS, TEACHERS = "legged.envs", "legged.teachers"

EnvFactory: TypeAlias = Callable[..., StudentEnv]
"""Called with the keyword options of the command line."""
TeacherLoader: TypeAlias = Callable[[Path], Teacher]
"""Called with the path of a checkpoint."""


def find_env(name: str) -> EnvFactory:
    """The environment factory `name` of group `legged.envs`.

    Raises:
        ProviderError: no installed package provides it.
    """
    return cast(EnvFactory, _load(_find(ENVS, name)))


def find_teacher(name: str | None = None) -> TeacherLoader:
    """The teacher loader `name` of group `legged.teachers`; None: the only one there is.

    Raises:
        ProviderError: no installed package provides it, or there are several to choose from.
    """
    return cast(TeacherLoader, _load(_find(TEACHERS, name)))


def _find(group: str, name: str | None) -> EntryPoint:
    found = {entry.name: entry for entry in entry_points(group=group)}
    what = "environment" if group == ENVS else "teacher"
    if not found:
        raise ProviderError(
            f"no installed package provides any {what} (entry-point group '{group}'); "
            "legged-locorl does: pip install legged-locorl"
        )
    names = ", ".join(sorted(found))
    if name is None and len(found) > 1:
        raise ProviderError(f"several packages provide a {what}; choose one of: {names}")
    chosen = name if name is not None else next(iter(found))
    if chosen not in found:
        raise ProviderError(f"no {what} is called '{chosen}'; installed: {names}")
    return found[chosen]


def _load(entry: EntryPoint) -> object:
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        raise ProviderError(
            f"'{entry.name}' of group '{entry.group}' ({entry.value}) cannot be loaded: {error}"
        ) from error
