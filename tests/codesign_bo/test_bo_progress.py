"""What is shown while a study runs: the live table, plain lines, and the time left."""

import re
import time
from io import StringIO

import pytest
from codesign_bo import BoxSpace, EvalRequest, EvalResult, Study
from codesign_bo.running.progress import LiveTable, PlainLines, Tally, display, duration
from rich.console import Console

SPACE = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)


@pytest.fixture
def study(tmp_path):
    with Study(SPACE, tmp_path / "study.sqlite", seed=5, n_init=100) as opened:
        yield opened


@pytest.fixture
def clock(monkeypatch):
    class Clock:
        now = 0.0

        def __call__(self):
            return self.now

    made = Clock()
    monkeypatch.setattr(time, "monotonic", made)
    return made


def request(trial, attempt=1, repeat=None):
    return EvalRequest(trial, attempt, {"a": 0.25, "b": "x"}, 0, token=f"{trial}-{attempt}-{repeat}", repeat=repeat)


def good(evaluation):
    return EvalResult(1.0 - (evaluation.params["a"] - 0.7) ** 2, 0.1, 4)


def lines(tally):
    out = StringIO()
    return PlainLines(tally, Console(file=out, width=40)), lambda: out.getvalue().splitlines()


def table(tally, width=100):
    """A live table and what is in it when it is drawn last."""
    out = StringIO()
    shown = display(None, tally, Console(file=out, force_terminal=True, width=width))
    assert isinstance(shown, LiveTable)

    def rows():
        console = Console(width=width, file=StringIO())
        console.print(shown._draw())
        return console.file.getvalue().splitlines()

    return shown, rows


# --- when what is shown ---------------------------------------------------------------------------------


def test_what_is_shown_where():
    tally = Tally(0, 3, lambda: "")
    terminal, log = Console(file=StringIO(), force_terminal=True), Console(file=StringIO())
    assert isinstance(display(None, tally, terminal), LiveTable)
    assert isinstance(display(True, tally, terminal), LiveTable)
    assert isinstance(display(True, tally, log), PlainLines)
    assert display(None, tally, log) is None
    assert display(False, tally, terminal) is None


def test_lines_of_a_study(study, capsys):
    study.run(good, until=2)
    assert capsys.readouterr().err == ""  # silent outside a terminal, unless asked

    def second(evaluation):
        return (
            EvalResult.failure("crash", "Traceback\n  deep\nValueError: three legs\n")
            if evaluation.trial == 2
            else good(evaluation)
        )

    study.run(second, until=4, progress=True)
    first, last = capsys.readouterr().err.splitlines()
    assert re.match(r"2 \(a=.*, b=.*\) crash ValueError: three legs in 0\.\d s; 3/4, 1 failed, .* per hour, ", first)
    best = study.best()
    assert re.match(r"3 \(a=.*\) ok 0\.\d+ ± 0\.1 in 0\.\d s; 4/4, 1 failed, ", last)
    assert last.endswith(f"0.0 s left, best so far: trial {best.trial}, {best.mean:.4g} ± {best.std:.2g}")


def test_failures_of_earlier_sessions_count(study, capsys):
    study.run(lambda r: EvalResult.failure("crash", "x") if r.trial == 1 else good(r), until=3)
    study.run(good, until=4, progress=True)
    assert "4/4, 1 failed" in capsys.readouterr().err


# --- the count, the rate, the time left -----------------------------------------------------------------


def test_the_time_left_is_what_the_rate_says(clock):
    tally = Tally(4, 10, lambda: "")
    assert str(tally) == "4/10"
    clock.now = 600.0
    tally.count()
    tally.count()
    assert str(tally) == "6/10, 12 per hour, 20:00 min left"
    assert [duration(s) for s in (0.04, 59.94, 61, 3723)] == ["0.0 s", "59.9 s", "1:01 min", "1:02:03"]


def test_what_runs_counts_by_the_share_that_is_done(clock):
    """Four at once, 100 s each: when the first ends, the rate is four in 100 s, not one."""
    tally = Tally(0, 8, lambda: "")
    clock.now = 100.0
    tally.count(seconds=100.0)
    assert tally.words([100.0, 100.0, 100.0]) == "1/8, 144 per hour, 1:40 min left"
    assert tally.words([50.0, 500.0]) == "1/8, 90 per hour, 3:40 min left"  # 2.5 in 100 s, 5.5 are left


def test_without_a_result_there_is_no_rate(clock):
    tally = Tally(3, 8, lambda: "", failed=2)
    clock.now = 100.0
    assert tally.words([100.0]) == "3/8, 2 failed"


# --- lines and tables -----------------------------------------------------------------------------------


def test_lines_say_what_still_runs(clock):
    shown, printed = lines(Tally(0, 3, lambda: "best so far: trial 9"))
    for i in range(3):
        shown.started(request(i))
    clock.now = 7.0
    shown.ended(request(1), EvalResult(3.25, 0.5, 4), "counted")
    shown.ended(request(0), EvalResult.failure("lost", "no [bold]worker"), "retry")
    first, second = printed()
    assert first.startswith("1 (a=0.25, b=x) ok 3.25 ± 0.5 in 7.0 s; 1/3, ")
    assert first.endswith("best so far: trial 9; running: 0, 2")
    assert second.startswith("0 (a=0.25, b=x) lost, retry no [bold]worker in 7.0 s; 1/3, ")
    assert second.endswith("running: 2")


def test_a_table_of_what_ended_and_what_runs(clock):
    shown, rows = table(Tally(0, 30, lambda: "best so far: trial 9"))
    for i in range(3):
        shown.started(request(i, attempt=2 if i == 2 else 1))
    clock.now = 90.0
    shown.ended(request(0), EvalResult(3.25, 0.5, 4), "counted")
    shown.ended(request(1), EvalResult.failure("crash", "x\nValueError: " + "long " * 30), "counted")
    drawn = rows()
    assert [row.split()[1] for row in drawn if row.startswith("│")] == ["0", "1", "2"]
    text = "\n".join(drawn)
    for words in ("a=0.25, b=x", "3.25 ± 0.5", "1:30 min", "crash", "ValueError: long", "running (attempt 2)"):
        assert words in text
    assert drawn[-1].startswith("1 running, 2/30, 1 failed, 120 per hour, ")
    assert drawn[-1].endswith("best so far: trial 9")


def test_a_table_of_many_workers_stays_short(clock):
    shown, rows = table(Tally(0, 300, lambda: ""))
    for i in range(40):
        shown.started(request(i))
    for i in range(20):
        shown.ended(request(i), EvalResult(float(i)), "counted")
    drawn = rows()
    numbers = [int(row.split()[1]) for row in drawn if row.startswith("│")]
    assert numbers == [*range(8, 20), *range(20, 32)]  # the last 12 that ended, and 12 that run
    assert any(row.startswith("and 8 more running") for row in drawn)


def test_attempts_that_another_one_settled_vanish():
    shown, rows = table(Tally(0, 3, lambda: ""))
    shown.started(request(0))
    shown.started(request(0, attempt=2))
    shown.started(request(0, repeat=1))  # a confirmation run is another evaluation
    shown.ended(request(0), EvalResult(1.0), "counted")
    assert [row.split()[1] for row in rows() if row.startswith("│")] == ["0", "0,"]
    assert "1 running" in rows()[-1]


def test_the_live_table_is_drawn():
    out = StringIO()
    shown = display(None, Tally(0, 1, lambda: ""), Console(file=out, force_terminal=True, width=100))
    with shown:
        shown.started(request(0))
        shown.ended(request(0), EvalResult(3.25), "counted")
    assert "3.25" in out.getvalue()
