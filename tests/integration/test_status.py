"""Where a run stands, read from folders that were left at many moments, and `codesign status`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from legged_codesign.run_log import LoggedConsole
from legged_codesign.stages import in_use, locked
from legged_codesign.watch.files import JsonLines, last_lines
from legged_codesign.watch.reader import RunReader, stage_names

Codesign = Callable[..., tuple[int, str]]


def statuses(folder: Path) -> dict[str, str]:
    return {stage.name: stage.status for stage in RunReader(folder).read().stages}


def test_a_run_that_was_only_bound(hand_made: Any) -> None:
    state = RunReader(hand_made.folder).read()
    assert state.status == "not begun"
    assert [stage.name for stage in state.stages] == list(hand_made.STAGES)
    assert {stage.status for stage in state.stages} == {"to do"}
    with locked(hand_made.folder):
        assert RunReader(hand_made.folder).read().words == "the run is starting"


@pytest.mark.parametrize("number", range(9))
def test_killed_in_each_stage(number: int, hand_made: Any) -> None:
    done, current = hand_made.STAGES[:number], hand_made.STAGES[number]
    hand_made.finish(*done)
    hand_made.enter(current)
    state = RunReader(hand_made.folder).read()
    assert state.status == "stopped"
    assert f"stage {number + 1} of 9, {current}" in state.words
    assert state.words.endswith("the same command goes on from there: codesign run --preset laptop")
    expected = ["done"] * number + ["stopped"] + ["to do"] * (8 - number)
    assert [stage.status for stage in state.stages] == expected
    assert state.elapsed == pytest.approx(10.0 * number)
    assert state.left is None


def test_a_running_stage(hand_made: Any) -> None:
    hand_made.finish("pretrain", "screen")
    hand_made.enter("search", ago=60.0)
    (hand_made.stages / "prediction.json").write_text('{"seconds": 500.0}')
    with locked(hand_made.folder):
        state = RunReader(hand_made.folder).read()
    assert state.status == "running"
    assert state.current is not None
    assert state.current.name == "search"
    assert state.current.seconds == pytest.approx(60.0, abs=5)
    assert state.elapsed == pytest.approx(80.0, abs=5)
    assert state.left == pytest.approx(420.0, abs=5), "500 s predicted, 80 s spent"


def test_a_stage_that_is_done_again_makes_the_later_ones_undone(hand_made: Any) -> None:
    hand_made.finish(*hand_made.STAGES)
    assert RunReader(hand_made.folder).read().status == "finished"
    hand_made.enter("confirm")
    assert statuses(hand_made.folder)["search"] == "done"
    assert statuses(hand_made.folder)["distil"] == "to do"


def test_trials_and_the_best_so_far(hand_made: Any) -> None:
    hand_made.finish("pretrain", "screen")
    hand_made.enter("search")
    hand_made.search(0.30, 0.20, None, 0.25, begun=True)
    state = RunReader(hand_made.folder).read()
    assert [trial.score for trial in state.trials] == [0.30, 0.20, None, 0.25, None]
    assert [trial.best_so_far for trial in state.trials] == [0.30, 0.20, 0.20, 0.20, 0.20]
    assert [trial.status for trial in state.trials] == ["ok", "ok", "infeasible", "ok", "interrupted"]
    assert state.trials[2].message == "has no stance"
    assert state.trials[0].tracking_error == 0.05
    assert state.trials[0].curve == [(100.0, 0.1), (200.0, 0.2)]
    assert state.trials[0].params == dict.fromkeys(state.trials[0].params, 1.0), "the nominal body is first"
    assert state.best == 1
    assert (state.current.done, state.current.total) == (4, 4)
    with locked(hand_made.folder):
        assert RunReader(hand_made.folder).read().trials[4].status == "running"


def test_reading_leaves_the_folder_as_it_is(hand_made: Any) -> None:
    """Not even SQLite's scratch files, which opening a study for reading would make."""
    hand_made.search(0.3, 0.2)
    before = {path: path.stat().st_mtime_ns for path in hand_made.folder.rglob("*")}
    reader = RunReader(hand_made.folder)
    assert len(reader.read().trials) == 2
    reader.read()
    assert {path: path.stat().st_mtime_ns for path in hand_made.folder.rglob("*")} == before


def test_a_study_that_another_process_is_writing(hand_made: Any) -> None:
    """Trials that are in the write-ahead log alone are seen, while the writer holds its lock."""
    hand_made.search(0.3)
    reader = RunReader(hand_made.folder)
    assert len(reader.read().trials) == 1
    code = (
        "import sys, json; from codesign_bo import EvalResult, Study, open_study\n"
        "path = sys.argv[1]\n"
        "with open_study(path) as v: space = v.space\n"
        "study = Study(space, path, seed=0, n_init=20)\n"
        "(r,) = study.ask(1); study.tell(r.trial, EvalResult(-0.1, 0.01, 8))\n"
        "print('told', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, hand_made.folder / "study.sqlite"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "told\n"
        state = reader.read()
        assert [trial.score for trial in state.trials] == [0.3, 0.1]
        assert not state.problems
        writer.kill()


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("config: [1, 2", "is no YAML"),
        ("", "not the configuration"),
        ("config: {}", "not the configuration"),
        ("- 1", "not the config"),
    ],
)
def test_a_damaged_configuration(text: str, word: str, hand_made: Any, codesign: Codesign) -> None:
    path = hand_made.folder / "config.yaml"
    path.write_text(text)
    state = RunReader(hand_made.folder).read()
    assert state.status == "damaged"
    assert str(path) in state.words
    assert word in state.words
    assert codesign("status", hand_made.folder)[0] == 0


def test_a_damaged_study_is_named_and_the_rest_is_shown(hand_made: Any) -> None:
    hand_made.finish("pretrain", "screen")
    hand_made.enter("search")
    (hand_made.folder / "study.sqlite").write_bytes(b"no database at all, but longer than a header" * 50)
    state = RunReader(hand_made.folder).read()
    assert str(hand_made.folder / "study.sqlite") in state.problems[0]
    assert "damaged" in state.problems[0]
    assert state.current.name == "search"


def test_half_a_study_and_half_a_choice(hand_made: Any) -> None:
    hand_made.search(0.3, 0.2)
    (hand_made.folder / "choice.json").write_text('{"trial": 1, "rep')
    content = (hand_made.folder / "study.sqlite").read_bytes()
    (hand_made.folder / "study.sqlite").write_bytes(content[: len(content) // 3])
    problems = RunReader(hand_made.folder).read().problems
    assert any("choice.json" in problem for problem in problems)
    assert any("study.sqlite" in problem for problem in problems)


def test_foreign_folders(tmp_path: Path, codesign: Codesign) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    for verb in ("status", "watch"):
        code, output = codesign(verb, tmp_path)
        assert code == 1
        assert "holds no run" in output
        code, output = codesign(verb, tmp_path / "missing")
        assert code == 1
        assert "there is no folder" in output
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_a_growing_file_of_lines(tmp_path: Path) -> None:
    path = tmp_path / "metrics.jsonl"
    lines = JsonLines(path)
    assert lines.read() == ()
    with path.open("w") as file:
        file.write('{"a": 1}\n{"a": 2')
        file.flush()
        assert lines.read() == ({"a": 1},), "half a line"
        file.write("}\nrubbish\n")
        file.flush()
        assert lines.read() == ({"a": 1}, {"a": 2})
    other = tmp_path / "new"
    other.write_text('{"a": 9}\n')
    os.replace(other, path)
    assert lines.read() == ({"a": 9},), "a resumed training replaces the file"
    path.unlink()
    assert lines.read() == ()


def test_progress_of_a_training(hand_made: Any) -> None:
    hand_made.enter("pretrain")
    (hand_made.folder / "pretrain").mkdir()
    rows = [{"iteration": i, "samples": 100 * i, "seconds": 2.0, "reward": 0.1 * i} for i in (1, 2)]
    (hand_made.folder / "pretrain" / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    with locked(hand_made.folder):
        state = RunReader(hand_made.folder).read()
    assert (state.current.done, state.current.total) == (2, 5)
    assert state.current.left == pytest.approx(3 * 2.0)
    assert [(curve.stage, list(curve.points)) for curve in state.curves] == [("pretrain", [(100, 0.1), (200, 0.2)])]


def test_asking_for_the_lock_does_not_keep_a_run_out(tmp_path: Path) -> None:
    assert not in_use(tmp_path)
    assert not list(tmp_path.iterdir())
    with locked(tmp_path):
        assert in_use(tmp_path)
    assert not in_use(tmp_path)
    asking = "import sys; from pathlib import Path; from legged_codesign.stages import in_use\nprint(flush=True)\n"
    with subprocess.Popen(
        [sys.executable, "-c", f"{asking}while True: in_use(Path(sys.argv[1]))", tmp_path], stdout=subprocess.PIPE
    ) as busy:
        assert busy.stdout is not None
        busy.stdout.readline()
        for _ in range(200):
            with locked(tmp_path):
                pass
        busy.kill()


def test_the_log_has_what_the_screen_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = LoggedConsole(Console(width=40))
    log.print("before")
    with pytest.raises(ZeroDivisionError), log.into(tmp_path):  # noqa: PT012
        log.print("[bold]3/9 search[/bold]")
        log.print("  a line that is longer than the screen is wide, which the log keeps in one piece")
        assert last_lines(tmp_path / "log.txt", 1)[0].endswith("in one piece"), "written at once"
        raise ZeroDivisionError("by zero")
    with log.into(tmp_path):
        log.print("again")
    texts = [line[21:] for line in (tmp_path / "log.txt").read_text().splitlines()]
    assert texts[0].startswith("$ ")
    assert texts[1] == "3/9 search"
    assert texts[2].strip() == "a line that is longer than the screen is wide, which the log keeps in one piece"
    assert texts[3] == "error: by zero"
    assert texts[5] == "again"
    assert "before" in capsys.readouterr().out


def test_status_of_a_run_in_words(hand_made: Any, codesign: Codesign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    hand_made.finish("pretrain", "screen", seconds=75.0)
    hand_made.enter("search")
    hand_made.search(0.30, 0.20, begun=True)
    (hand_made.folder / "log.txt").write_text("2026-01-01 10:00:00  3/9 search\n")
    code, output = codesign("status", hand_made.folder)
    assert code == 0
    assert "codesign run --preset laptop" in output
    assert "1 min 15 s" in output
    assert "1 *" in output
    assert "0.2000" in output
    assert "interrupted" in output
    assert "3/9 search" in output


def test_status_of_all_runs(hand_made: Any, codesign: Codesign, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(hand_made.folder.parents[1])
    hand_made.finish(*hand_made.STAGES)
    other = hand_made.folder.parent / "other"
    other.mkdir()
    (other / "config.yaml").write_text("rubbish")
    code, output = codesign("status")
    lines = [line for line in output.splitlines() if line.startswith("runs/")]
    assert code == 0
    assert lines[0].startswith("runs/mine  finished")
    assert lines[1].startswith("runs/other  damaged")
    monkeypatch.chdir(other)
    assert "no run under ./runs" in codesign("status")[1]


def test_stages_of_a_student_and_of_a_run_with_one_that_adapts(hand_made: Any) -> None:
    adapting = {"distil": {"adapt": {"finetune": {"iterations": 3}}}}
    assert stage_names(adapting) == ["adapt", "distil", "compare", "export"]
    assert stage_names(hand_made.CONFIG | adapting)[4] == "adapt"


@pytest.mark.slow
def test_a_finished_run(finished: Any) -> None:
    """The names of the stages are those of a real run."""
    state = RunReader(finished.folder).read()
    assert state.status == "finished"
    on_disk = {path.stem for path in (finished.folder / "stages").glob("*.json")} - {"prediction", "progress"}
    assert {stage.name for stage in state.stages} == on_disk
    table = json.loads((finished.folder / "trials.json").read_text())
    assert [trial.params for trial in state.trials] == [row["params"] for row in table]
    assert state.best == json.loads((finished.folder / "choice.json").read_text())["trial"]
    assert {curve.stage for curve in state.curves} >= {"pretrain", "distil"}
    log = (finished.folder / "log.txt").read_text()
    for name in on_disk:
        assert f"/{len(on_disk)} {name}" in log
