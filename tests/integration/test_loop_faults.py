"""Bad input and broken files: a clear error, exit code 1, nothing deleted."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from legged_codesign.stages import locked

Codesign = Callable[..., tuple[int, str]]


@pytest.fixture
def copy(finished, tmp_path: Path) -> Path:
    """A finished run to damage."""
    assert finished.code == 0, finished.output
    folder = tmp_path / "run"
    shutil.copytree(finished.folder, folder)
    return folder


def refused(result: tuple[int, str], *words: str) -> None:
    code, output = result
    assert code == 1, output
    assert "error:" in output
    assert "Traceback" not in output
    for word in words:
        assert word in output, f"'{word}' is not in: {output}"


# ---------------------------------------------------------------- before anything starts


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--robot", "spot"), ("spot", "go2")),
        (("--bounds", "front_shank=1-1.4"), ("front_shank=1-1.4", "name=low:high")),
        (("--bounds", "front_shank=1:"), ("name=low:high",)),
        (("--bounds", "front_shank=1:much"), ("name=low:high",)),
        (("--bounds", "front_shin=1:1.4"), ("front_shin",)),
        (("--bounds", "front_shank=1.4:1"), ("front_shank", "1.4")),
        (("--bounds", "front_shank=1.1:1.4"), ("front_shank", "1.0", "outside [1.1, 1.4]")),
        (("--bounds", "front_shank=0.5:1.4"), ("front_shank", "[0.5, 1.4]", "[0.6, 1.4]")),
        (("--bounds", "front_shank=0.9:nan"), ("front_shank", "finite")),
        (("--fix", "front_thigh"), ("front_thigh", "name=value")),
        (("--fix", "front_thigh=long"), ("name=value",)),
        (("--fix", "tail=1"), ("tail",)),
        (("--fix", "front_thigh=1.5"), ("front_thigh", "1.5", "outside [0.6, 1.4]")),
        (("--fix", "front_thigh=1", "front_shank=1", "hind_thigh=1", "hind_shank=1"), ("no free parameter",)),
        (("--fix", "front_thigh=1.4", "front_shank=1.4", "hind_thigh=0.6", "hind_shank=0.6"), ()),
        (("--trials", "1"), ("trials", "at least 2")),
        (("--seed", "-1"), ("seed", "-1")),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) and value and value[0][:2] == "--" else "",
)
def test_bad_options_are_refused_before_any_work(
    options: tuple[str, ...], words: tuple[str, ...], codesign: Codesign, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    refused(codesign("run", "--preset", "smoke", "--folder", folder, *options), *words)
    assert not folder.exists(), "a refused command must not claim the folder"


def test_report_of_no_run(codesign: Codesign, tmp_path: Path) -> None:
    refused(codesign("report", tmp_path), str(tmp_path), "config.yaml")


# ---------------------------------------------------------------- the run folder


def test_folder_of_another_configuration(copy: Path, codesign: Codesign, snapshot: Callable) -> None:
    before = snapshot(copy)
    options = ("--seed", "5", "--trials", "6")
    refused(codesign("run", "--preset", "smoke", "--folder", copy, *options), "seed: 0 -> 5", "search.trials: 4 -> 6")
    assert snapshot(copy) == before


def test_two_runs_on_one_folder(copy: Path, codesign: Codesign) -> None:
    with locked(copy):
        refused(codesign("run", "--preset", "smoke", "--folder", copy), "another run is using", str(copy))


def test_folder_that_cannot_be(tmp_path: Path, codesign: Codesign) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("mine")
    refused(codesign("run", "--preset", "smoke", "--folder", file / "run"), "notes.txt", "--folder")
    refused(codesign("run", "--preset", "smoke", "--folder", file), "notes.txt", "--folder")
    assert file.read_text() == "mine"


def test_folder_name_with_brackets(tmp_path: Path, codesign: Codesign) -> None:
    """Messages pass through rich, for which brackets are markup."""
    file = tmp_path / "[bold]"
    file.write_text("mine")
    refused(codesign("run", "--preset", "smoke", "--folder", file / "run"), "[bold]/run")


@pytest.mark.parametrize(
    "text", ["config: [1, 2", "", "- config", "config: 3", "other: {}", "\0"], ids=lambda t: repr(t)
)
@pytest.mark.parametrize("verb", [("run", "--preset", "smoke", "--folder"), ("report",)], ids=lambda v: v[0])
def test_broken_config(text: str, verb: tuple[str, ...], copy: Path, codesign: Codesign, snapshot: Callable) -> None:
    (copy / "config.yaml").write_text(text)
    before = snapshot(copy)
    refused(codesign(*verb, copy), "config.yaml", "damaged")
    assert snapshot(copy) == before


# ---------------------------------------------------------------- what stages left on disk


def test_garbage_in_the_study(copy: Path, codesign: Codesign, snapshot: Callable) -> None:
    (copy / "trials.json").unlink()  # as if the search were not done
    (copy / "study.sqlite").write_bytes(b"this is no database " * 400)
    before = snapshot(copy)
    refused(codesign("run", "--preset", "smoke", "--folder", copy), "study.sqlite", "restore it")
    assert snapshot(copy) == before


@pytest.mark.parametrize("size", [0, 1000], ids=["empty", "truncated"])
def test_truncated_generalist(size: int, copy: Path, codesign: Codesign, snapshot: Callable) -> None:
    policy = copy / "pretrain" / "generalist.pt"
    whole = policy.read_bytes()
    policy.write_bytes(whole[:size])
    before = snapshot(copy)
    refused(codesign("run", "--preset", "smoke", "--folder", copy), str(policy), "delete it")
    assert snapshot(copy) == before
    # the way out that the message names
    policy.unlink()
    code, output = codesign("run", "--preset", "smoke", "--folder", copy)
    assert code == 0, output
    assert policy.read_bytes() == whole
    assert output.count("unchanged, skipped") == 8


def test_altered_bundle_is_not_run(copy: Path, codesign: Codesign) -> None:
    (copy / "rollout.json").unlink()
    (copy / "bundle" / "scene.xml").write_text("<mujoco/>")
    refused(codesign("run", "--preset", "smoke", "--folder", copy), "scene.xml")
    assert (copy / "rollout.mcap").exists()


def test_study_of_another_generalist(copy: Path, codesign: Codesign, untrained) -> None:
    """Old trials must not pass for those of a new generalist."""
    untrained.save(copy / "pretrain" / "generalist.pt")
    refused(codesign("run", "--preset", "smoke", "--folder", copy), "another generalist", "--folder")
    assert (copy / "study.sqlite").exists()


def test_lost_best_urdf_is_written_again(copy: Path, finished, codesign: Codesign) -> None:
    (copy / "best.urdf").unlink()
    code, output = codesign("run", "--preset", "smoke", "--folder", copy)
    assert code == 0, output
    assert (copy / "best.urdf").read_bytes() == (finished.folder / "best.urdf").read_bytes()
    assert output.count("unchanged, skipped") == 8


@pytest.mark.slow
def test_full_disk(smoke_command: Callable, run_smoke: Callable, finished, tmp_path: Path) -> None:
    """No file may grow beyond 64 kB, as on a full disk; given room, the run goes on to the same result."""
    folder = tmp_path / "run"
    limited = subprocess.run(
        ["bash", "-c", 'ulimit -f 64; exec "$@"', "bash", *smoke_command(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
    )
    refused(
        (limited.returncode, limited.stdout),
        f"cannot write {folder / 'pretrain' / 'policy.pt'}",
        "the previous file is untouched",
    )
    resumed = run_smoke(folder)
    assert resumed.code == 0, resumed.output
    assert (folder / "trials.json").read_text() == (finished.folder / "trials.json").read_text()
