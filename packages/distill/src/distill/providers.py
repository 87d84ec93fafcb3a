"""Find environments and teachers of other packages by their entry points."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import cast

from distill.errors import ProviderError
from distill.interfaces import StudentEnv, Teacher

ENVS, TEACHERS = "legged.envs", "legged.teachers"


def make_env(name: str, options: Mapping[str, object]) -> StudentEnv:
    """Make the environment `name` of group `legged.envs` with its provider's options.

    Raises:
        ProviderError: no installed package provides it, or it refuses the options.
    """
    factory = cast(Callable[..., StudentEnv], _load(_find(ENVS, name)))
    with _provider_errors(f"environment '{name}'"):
        return factory(**options)


def load_teacher(path: Path, name: str | None = None) -> Teacher:
    """Load a teacher with the loader `name` of group `legged.teachers`; None: the only one there is.

    Raises:
        ProviderError: no installed package provides it, there are several to choose from, or it
            cannot read the file.
    """
    loader = cast(Callable[[Path], Teacher], _load(_find(TEACHERS, name)))
    with _provider_errors(f"teacher {path}"):
        return loader(path)


@contextmanager
def _provider_errors(what: str) -> Iterator[None]:
    """Turn a provider's refusal of its input into an error of one line."""
    try:
        yield
    except (LookupError, OSError, RuntimeError, TypeError, ValueError) as error:
        raise ProviderError(f"{what}: {error}") from error


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
