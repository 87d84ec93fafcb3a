"""Where a run keeps the study of its search: in its folder, or by a link from there on a local disk."""

from __future__ import annotations

from pathlib import Path

from codesign_bo.storage.filesystem import network_mount

from legged_codesign.run_folder import Files
from legged_codesign.stages import RunError


def check_study(folder: Path, study: Path | None) -> None:
    """Refuse a place where the search would fail in the end.

    Args:
        folder: of the run, which need not exist.
        study: file to keep the study in; None for the run folder, or for where it is already.

    Raises:
        RunError: the study would lie on a network file system, is another run's, or is not on this machine.
    """
    files = Files(folder)
    link, begun = files.study, files.trials.with_suffix("").exists()
    if files.choice.exists():
        return  # the search is over, and to read is allowed everywhere
    if study is not None and not (link.exists() or link.is_symlink()) and study.exists():
        raise RunError(f"--study {study} is there already; name a file that another run does not have")
    if study is not None and (link.exists() or link.is_symlink()) and link.resolve() != study.resolve():
        raise RunError(f"the study of {folder} is {link.resolve()} already; leave --study out to go on with it")
    if begun and link.is_symlink() and not link.exists():
        raise RunError(
            f"{link} leads to {link.resolve()}, which is not on this machine; go on where it is, or put a copy in "
            "the place of the link"
        )
    place = link if study is None else study
    found = network_mount(place)
    if found is not None:
        raise RunError(
            f"{place} lies on a network file system ({found}), where SQLite may lose or damage trials; --study PATH "
            "keeps it on a local disk of this machine, and all else in the run folder"
        )


def place_study(folder: Path, study: Path | None) -> None:
    """Make `study.sqlite` in a run folder a link to `study`, by which everything finds it; see `check_study`.

    Raises:
        RunError: the link or the folder of `study` cannot be made.
    """
    link = Files(folder).study
    if study is None or link.is_symlink() or link.exists():
        return
    try:
        study.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(study.resolve())
    except OSError as error:
        raise RunError(f"cannot keep the study of {folder} at {study}: {error}; choose another --study") from error
