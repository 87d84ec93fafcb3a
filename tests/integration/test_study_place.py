"""A run folder on a network file system: refused before anything starts, or its study is elsewhere."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from pathlib import Path

import codesign_bo
import pytest
from codesign_bo.storage.filesystem import network_mount, refuse_network
from rich.console import Console

from legged_codesign import pipeline, study_place
from legged_codesign.presets import preset
from legged_codesign.report.data import read_run
from legged_codesign.stages import RunError
from legged_codesign.study_place import check_study, place_study
from legged_codesign.watch.reader import RunReader


@pytest.fixture
def share(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that the system says is on NFS."""
    mounts = tmp_path / "mounts"
    mounts.write_text(f"server:/x {tmp_path / 'share'} nfs4 rw 0 0\n")
    monkeypatch.setattr(study_place, "network_mount", functools.partial(network_mount, mounts=mounts))
    # where the search itself looks
    refuse = functools.partial(refuse_network, mounts=mounts)
    monkeypatch.setattr("codesign_bo.storage.database.refuse_network", refuse)
    return tmp_path / "share"


@pytest.mark.parametrize("more", [(), ("--dry-run",)])
def test_a_folder_on_a_network_file_system_is_refused_at_once(
    more: tuple[str, ...], share: Path, codesign: Callable[..., tuple[int, str]]
) -> None:
    code, output = codesign("run", "--preset", "smoke", "--folder", share / "run", *more)
    assert code == 1
    assert "nfs4" in output
    assert "--study" in output
    assert not share.exists()


def test_a_run_makes_the_link_before_it_starts(share: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise RunError("this far")

    monkeypatch.setattr(pipeline, "predict", stop)
    local = tmp_path / "disk" / "mine.sqlite"
    with pytest.raises(RunError, match="this far"):
        pipeline.run(preset("smoke"), share / "run", Console(file=io.StringIO()), study=local)
    assert (share / "run" / "study.sqlite").resolve() == local
    assert local.parent.is_dir()


def test_a_study_elsewhere_is_found_by_everything(share: Path, tmp_path: Path, hand_made) -> None:
    folder = share / "mine"
    share.mkdir()
    hand_made.folder.rename(folder)
    hand_made.folder, hand_made.stages = folder, folder / "stages"
    local = tmp_path / "disk" / "mine.sqlite"
    place_study(folder, local)
    hand_made.search(0.3, 0.2, begun=True)
    hand_made.enter("search")
    check_study(folder, None)  # the link is the record
    check_study(folder, local)
    place_study(folder, local)
    with codesign_bo.Study.resume(folder / "study.sqlite") as study:
        assert len(study.trials()) == 3
        assert study.workdir == folder / "trials", "what machines of a cluster write stays in the run folder"
    assert local.is_file()
    assert len(read_run(folder).trials) == 3
    state = RunReader(folder).read()
    assert [trial.score for trial in state.trials] == pytest.approx([0.3, 0.2, None])
    assert state.idle is not None
    assert state.idle < 60

    with pytest.raises(RunError, match=r"mine\.sqlite already; leave --study out"):
        check_study(folder, tmp_path / "other.sqlite")
    with pytest.raises(RunError, match="is there already"):
        check_study(share / "second", local)
    (folder / "trials").mkdir()
    local.unlink()
    with pytest.raises(RunError, match="not on this machine"):
        check_study(folder, None)


def test_studies_of_several_seeds_are_several_files(tmp_path: Path) -> None:
    from legged_codesign.commands.run import Run

    run = Run(seeds=(1, 2), study=tmp_path / "mine.sqlite")
    assert [run._places(Path("x"), seed) for seed in run._seeds()] == [
        (Path("x/seed-1"), tmp_path / "mine-1.sqlite"),
        (Path("x/seed-2"), tmp_path / "mine-2.sqlite"),
    ]
