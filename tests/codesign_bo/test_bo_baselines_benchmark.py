"""The loop, the records and the statistics of benchmarks/bo.py."""

import json
import math
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from codesign_bo.baselines import make_optimiser
from scipy import stats

sys.path.append(str(Path(__file__).parents[2]))

from benchmarks.bo_problems import PROBLEMS
from benchmarks.bo_runs import Job, Records, Trace, record_line, run, simulate
from benchmarks.bo_statistics import Interval, Results, bars, median_interval, ratio_interval

ROOT = Path(__file__).parents[2]
LEVY = PROBLEMS["levy4"]


class Scripted:
    """Asks for random designs, recommends the last told, and writes down what happens."""

    def __init__(self, problem):
        self.rng, self.problem = np.random.default_rng(0), problem
        self.asked, self.told, self.most_out = [], [], 0

    def ask(self):
        design = self.rng.uniform(self.problem.low, self.problem.high, len(self.problem.parameters))
        self.asked.append(dict(zip(self.problem.parameters, design.tolist(), strict=True)))
        self.most_out = max(self.most_out, len(self.asked) - len(self.told))
        return self.asked[-1]

    def tell(self, params, mean, sem):
        self.told.append((self.asked.index(params), mean, sem))

    def recommend(self):
        number, mean, _ = self.told[-1]
        if math.isnan(mean):
            raise LookupError
        return self.asked[number]


def finishing_order(durations, workers):
    """The k-th evaluation starts when the (k - workers + 1)-th of the earlier ones ends."""
    ends = []
    for number, duration in enumerate(durations):
        ends.append((sorted(ends)[number - workers] if number >= workers else 0.0) + duration)
    return np.argsort(ends).tolist()


@pytest.mark.parametrize("workers", [1, 2, 4])
def test_workers_finish_in_the_order_of_a_queue(workers):
    optimiser = Scripted(LEVY)
    trace = simulate(optimiser, LEVY, 5, 30, workers)
    durations = np.random.default_rng((5, 2)).lognormal(0.0, 0.5, 30)
    order = [number for number, _, _ in optimiser.told]
    assert order == finishing_order(durations, workers)
    assert (order == list(range(30))) == (workers == 1)
    assert optimiser.most_out == workers
    expected = [LEVY.regret(optimiser.asked[number]) for number in order]
    assert list(trace.regret) == list(trace.visited) == expected


@pytest.mark.parametrize("workers", [1, 3])
def test_the_noise_of_an_evaluation_is_the_same_whoever_asks(workers):
    problem = PROBLEMS["noisy-hartmann4"]
    optimiser = Scripted(problem)
    simulate(optimiser, problem, 8, 12, workers)
    draws = np.random.default_rng((8, 0)).standard_normal(12)
    for number, mean, sem in optimiser.told:
        value = problem.best - problem.regret(optimiser.asked[number])
        assert mean == pytest.approx(value + sem * draws[number], abs=1e-9)


def test_a_failure_has_no_regret_and_an_optimiser_may_have_nothing_to_recommend():
    problem = PROBLEMS["legs4"]
    optimiser = Scripted(problem)
    trace = simulate(optimiser, problem, 0, 40)
    failed = [math.isnan(mean) for _, mean, _ in optimiser.told]
    assert [math.isinf(r) for r in trace.regret] == [math.isinf(r) for r in trace.visited] == failed
    assert 0 < sum(failed) < 40


def test_runs_repeat_and_differ_by_seed():
    job = Job("random", "levy4", 3, 12, workers=2)
    assert run(job).regret == run(job).regret
    assert run(job).regret != run(Job("random", "levy4", 4, 12, workers=2)).regret
    optimiser = make_optimiser("random", LEVY.space(3), 3)
    assert simulate(optimiser, LEVY, 3, 12, 2).visited == run(job).visited


def test_records_give_back_what_was_added_and_forget_what_was_cut_short(tmp_path):
    records = Records(tmp_path / "deep" / "records.jsonl")
    jobs = [Job("random", "legs4", seed) for seed in range(3)]
    traces = [Trace((math.inf, 1.5, 0.25), (math.inf, 1.5, 2.0), 0.01 * seed) for seed in range(3)]
    assert records.load(jobs) == {}
    records.add(jobs[0], traces[0])
    with records.path.open("a") as file:
        file.write(record_line(jobs[1], traces[1])[:50])
    assert records.load(jobs) == {jobs[0]: traces[0]}
    records.add(jobs[2], traces[2])
    assert records.load(jobs) == {jobs[0]: traces[0], jobs[2]: traces[2]}
    assert records.load(jobs[1:]) == {jobs[2]: traces[2]}
    assert records.load([Job("random", "legs4", 0, workers=2)]) == {}


def test_runs_of_other_code_do_not_count(tmp_path):
    records, job = Records(tmp_path / "records.jsonl"), Job("random", "legs4", 0)
    records.add(job, Trace((1.0,), (1.0,), 0.1))
    row = json.loads(records.path.read_text())
    records.path.write_text(json.dumps(row | {"fingerprint": "of another day"}) + "\n")
    assert records.load([job]) == {}


def test_intervals_agree_with_scipys_bootstrap():
    values = np.random.default_rng(0).lognormal(size=25)
    expected = stats.bootstrap(
        (values,), np.median, confidence_level=0.9, method="percentile", n_resamples=20_000, rng=1
    )
    found = median_interval(values)
    assert found.value == np.median(values)
    assert found.low == pytest.approx(expected.confidence_interval.low, abs=0.05)
    assert found.high == pytest.approx(expected.confidence_interval.high, abs=0.05)


def test_ratios_are_taken_seed_by_seed():
    rng = np.random.default_rng(0)
    bottoms = [rng.lognormal(size=21) for _ in range(2)]
    exact = ratio_interval([3.0 * bottoms[0], 12.0 * bottoms[1]], bottoms)
    assert (exact.value, exact.low, exact.high) == pytest.approx((6.0, 6.0, 6.0))
    loose = ratio_interval([rng.permutation(bottoms[0])], bottoms[:1])
    assert loose.value == pytest.approx(1.0)
    assert loose.low < 0.8
    assert loose.high > 1.25


def results(ours, paper, peer, asynchronous=1.0):
    """Regret that depends on the seed, times a factor by problem."""
    traces = {}
    for seed in range(21):
        base = 1.0 + 0.01 * seed
        for method, factors in (("codesign-bo", ours), ("hyperopt-tpe", paper), ("optuna-gp", peer)):
            for problem, factor in factors.items():
                traces[Job(method, problem, seed)] = Trace((9.0, factor * base), (9.0, 0.5 * factor * base), 0.2)
                if method == "codesign-bo":
                    again = Trace((9.0, asynchronous * factor * base), (9.0, 0.1), 0.2)
                    traces[Job(method, problem, seed, workers=4)] = again
    return Results(traces)


def factors(*values):
    return dict(zip(("noisy-hartmann4", "ackley4", "hartmann6", "levy4", "legs4"), values, strict=True))


def test_rows_compare_by_seed():
    found = results(factors(0.1, 1, 1, 1, 1), factors(*[2] * 5), factors(1.1, 1, 0.5, 1, 1))
    row = found.row("codesign-bo", "noisy-hartmann4")
    assert row.median.value == pytest.approx(0.11)
    assert row.quartiles == pytest.approx((0.105, 0.115))
    assert row.visited == pytest.approx(0.055)
    assert row.beats_paper == 1.0
    assert row.to_peer is not None
    assert row.to_peer.value == pytest.approx(-1.1)
    assert row.to_peer.high < 0
    assert found.row("codesign-bo", "hartmann6").to_peer.low > 0
    assert found.row("codesign-bo", "ackley4").to_peer == Interval(0.0, 0.0, 0.0)
    peer = found.row("optuna-gp", "ackley4")
    assert (peer.to_peer, peer.beats_paper) == (None, 1.0)
    assert found.row("hyperopt-tpe", "ackley4").beats_paper is None
    assert found.curve("codesign-bo", "ackley4")[1] == pytest.approx([9.0, 1.1])


def test_bars_are_met_or_missed_by_what_was_asked():
    good = results(factors(0.2, 3, 0.5, 0.5, 1), factors(*[5] * 5), factors(1, 1, 1, 1, 1), 1.1)
    found = bars(good, {"hartmann6": 1.9})
    assert [bar.met for bar in found] == [True] * len(found)
    assert len(found) == 7
    assert "aim reached" not in found[0].measured  # the median is 0.22
    bad = results(factors(0.3, 4, 0.5, 1, 1.5), factors(0.31, 5, 5, 5, 5), factors(1, 1, 1, 1, 1), 1.2)
    met = {bar.text: bar.met for bar in bars(bad, {"hartmann6": 2.1})}
    assert [text for text, fine in met.items() if fine] == [
        "noisy-hartmann4: better than hyperopt-tpe on at least 80 % of seeds"
    ]


@pytest.mark.slow
def test_a_killed_benchmark_goes_on_where_it_stopped(tmp_path):
    pytest.importorskip("legged_codesign")
    command = [sys.executable, "benchmarks/bo.py", "--methods", "random", "sobol", "--problems", "legs4", "ackley4"]
    command += ["--seeds", "100", "--evaluations", "10", "--processes", "1", "--folder", str(tmp_path)]
    records = tmp_path / "records.jsonl"
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while not (records.is_file() and records.read_bytes().count(b"\n") >= 20):
            assert process.poll() is None
            time.sleep(0.02)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    before = records.read_bytes()
    assert before.count(b"\n") < 400
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "400/400" in done.stdout
    after = records.read_bytes()
    assert after.startswith(before)
    rows = [json.loads(line)["job"] for line in after.splitlines() if line.endswith(b"}")]
    assert len({json.dumps(row) for row in rows}) == len(rows) == 400
    assert {path.name for path in tmp_path.iterdir()} == {"records.jsonl", "README.md", "runs.jsonl", "regret.png"}
    assert len((tmp_path / "runs.jsonl").read_text().splitlines()) == 400
