"""SlurmExecutor: on submitit's local cluster, and on a Slurm made of shell scripts."""

import os
import signal

import pytest
from codesign_bo.executors import SlurmExecutor
from codesign_bo.testing import callbacks
from codesign_bo.testing.executors import ExecutorContract, begun, gone, outcome, request

pytest.importorskip("submitit")
pytestmark = pytest.mark.slow


class TestSubmititLocal(ExecutorContract):
    @pytest.fixture
    def executor(self, tmp_path):
        # its jobs end by this signal, which is ignored by what a shell has started in the background
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        with SlurmExecutor(2, tmp_path / "jobs", timeout_min=5, cluster="local") as executor:
            yield executor
        signal.signal(signal.SIGINT, before)


# Jobs are numbered, have a file <number>.state for sacct, and run in a session of their own.
SLURM = {
    "srun": "",
    "sbatch": """
        job=$(($(ls *.state 2> /dev/null | wc -l) + 1))
        cp "$1" $job.script
        echo RUNNING > $job.state
        export SLURM_JOB_ID=$job
        setsid sh -c '
            echo $$ > $0.pid
            if bash $0.script; then end=COMPLETED; else end=FAILED; fi
            if grep -q RUNNING $0.state; then echo $end > $0.state; fi
        ' $job > $job.log 2>&1 &
        echo "Submitted batch job $job"
    """,
    "sacct": """
        echo "JobID|State|NodeList"
        for file in *.state; do echo "${file%.state}|$(cat $file)|localhost"; done
    """,
    "scancel": """
        if grep -q RUNNING $1.state; then echo "CANCELLED by 0" > $1.state; fi
        kill -s KILL -- -$(cat $1.pid)
    """,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a Slurm that runs jobs on this machine; a single one, because it gives each number once."""
    folder = tmp_path_factory.mktemp("slurm")
    for name, script in SLURM.items():
        (folder / name).write_text(f"#!/bin/sh\ncd {folder}\n{script}")
        (folder / name).chmod(0o755)
    return folder


@pytest.fixture
def slurm(folder, monkeypatch):
    """Slurm on the path; gives a function from a suffix to the file of the newest job."""
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    return lambda suffix: folder / f"{len(list(folder.glob('*.state')))}.{suffix}"


@pytest.fixture
def executor(slurm, tmp_path):
    with SlurmExecutor(
        2, tmp_path / "jobs", timeout_min=90, mem_gb=2, slurm_partition="gpu", slurm_use_srun=False
    ) as executor:
        yield executor


def test_a_job_has_the_settings_and_is_never_requeued(executor, slurm, tmp_path):
    sent = request(tmp_path, 0)
    assert outcome(executor.submit(callbacks.echo, sent)) == callbacks.echo(sent)
    script = slurm("script").read_text()
    for flag in ("--no-requeue", "--time=90", "--mem=2GB", "--partition=gpu"):
        assert f"#SBATCH {flag}\n" in script


@pytest.mark.parametrize(
    ("state", "kind"),
    [
        ("TIMEOUT", "timeout"),
        ("OUT_OF_MEMORY", "crash"),
        ("PREEMPTED", "lost"),
        ("NODE_FAIL", "lost"),
        ("CANCELLED by 1000", "lost"),
        ("FAILED", "crash"),
    ],
)
def test_the_verdict_of_slurm_tells_failures_apart(executor, slurm, tmp_path, state, kind):
    sent = request(tmp_path, 0)
    job = executor.submit(callbacks.wait_for_go, sent)
    process = begun(sent)
    os.kill(process, signal.SIGUSR2)  # Slurm's warning before a time limit or a preemption
    slurm("state").write_text(state)
    os.kill(process, signal.SIGTERM)
    result = outcome(job)
    assert result.status == kind
    assert state.split()[0] in result.message
    assert ("out of memory" in result.message) == (state == "OUT_OF_MEMORY")
    gone(process)


def test_cancelling_takes_the_job_off_the_cluster(executor, slurm, tmp_path):
    sent = request(tmp_path, 0)
    job = executor.submit(callbacks.wait_for_go, sent)
    process = begun(sent)
    job.cancel()
    assert outcome(job).status == "lost"
    gone(process)
    assert slurm("state").read_text().startswith("CANCELLED")


def test_a_dead_process_is_a_crash_with_its_last_words(executor, tmp_path):
    result = outcome(executor.submit(callbacks.kill_process, request(tmp_path, 0)))
    assert result.status == "crash"
    assert "FAILED" in result.message


def test_no_slurm_and_unknown_settings_are_refused(tmp_path, monkeypatch):
    with pytest.raises(NameError, match="gpus"):
        SlurmExecutor(1, tmp_path, timeout_min=5, cluster="local", gpus=1)
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(RuntimeError, match="slurm cluster"):
        SlurmExecutor(1, tmp_path, timeout_min=5)
