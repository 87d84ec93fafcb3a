"""A Ray cluster that dies, or that is too small: neither is any trial's fault."""

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

import psutil
import pytest
from codesign_bo import ExecutorError, open_study
from codesign_bo.executors.ray_cluster import check_resources
from codesign_bo.testing.executors import until

SEARCH = """
import sys, time
from codesign_bo import BoxSpace, EvalResult, Study
from codesign_bo.executors import RayExecutor


def score(request):
    (request.workdir / "begun").touch()
    while request.trial >= 2 and not (request.workdir.parents[1] / "go").exists():
        time.sleep(0.02)
    return EvalResult(1.0 - (request.params["a"] - 0.7) ** 2, 0.1, 4)


if __name__ == "__main__":
    space = BoxSpace.box(["a", "b"], 0.0, 1.0, 0.5)
    with Study(space, sys.argv[1], seed=4, n_init=5) as study, RayExecutor(slots=2) as executor:
        study.run(score, until=5, executor=executor, progress=False)
"""


def node(alive: bool = True, **resources: float) -> dict[str, object]:
    return {"Alive": alive, "Resources": {"memory": 16e9, **resources}}


def test_what_no_node_has_is_refused_with_what_they_have() -> None:
    nodes = [node(CPU=8.0), node(CPU=4.0, GPU=1.0), node(alive=False, CPU=64.0, GPU=8.0)]
    check_resources(nodes, {"CPU": 8.0}, "head:1")
    check_resources(nodes, {"CPU": 4.0, "GPU": 0.5, "memory": 16e9}, "head:1")
    with pytest.raises(ExecutorError, match=r"needs 16 CPU, .*head:1 .*: 2 with 4 CPU; 8 CPU\. Ask for less"):
        check_resources(nodes, {"CPU": 16.0}, "head:1")
    # together they would have it, and a trial needs one node
    with pytest.raises(ExecutorError, match=r"needs 8 CPU, 1 GPU, .*4 CPU, 1 GPU; 8 CPU, 0 GPU"):
        check_resources(nodes, {"CPU": 8.0, "GPU": 1.0}, "head:1")
    with pytest.raises(ExecutorError, match=r"needs 32 GB of memory, .*16 GB of memory"):
        check_resources(nodes, {"memory": 32e9}, "head:1")
    with pytest.raises(ExecutorError, match="0 with nothing"):
        check_resources([], {"CPU": 1.0}, "head:1")


class Head:
    """`ray start --head` with two cores, on a port of its own."""

    def __init__(self, port: int) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="ray-", dir="/tmp"))  # short: sockets are below it
        options = {"port": port, "num-cpus": 2, "temp-dir": self._folder, "ray-client-server-port": free_port()}
        program = [sys.executable, "-m", "ray.scripts.scripts", "start", "--head", "--block"]
        self._process = psutil.Popen(
            [*program, "--include-dashboard=false", *(f"--{name}={value}" for name, value in options.items())],
            stdout=(self._folder / "output.txt").open("w"),
            stderr=subprocess.STDOUT,
            env={**os.environ, "RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0"},
            start_new_session=True,
        )
        until(self._listens)

    def _listens(self) -> bool:
        assert self._process.poll() is None, (self._folder / "output.txt").read_text()
        return "Ray runtime started" in (self._folder / "output.txt").read_text()

    def kill(self) -> None:
        """Kill -9 the head and all that it started, as when its machine goes."""
        if self._process.poll() is None:
            family = [self._process, *self._process.children(recursive=True)]
            for process in family:
                process.send_signal(signal.SIGSTOP)  # nobody is to notice and tidy up
            for process in family:
                process.kill()
            self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)


def free_port() -> int:
    with socket.socket() as free:
        free.bind(("", 0))
        return free.getsockname()[1]


@pytest.mark.slow
def test_a_head_that_dies_costs_no_trial_and_the_same_command_goes_on(tmp_path: Path) -> None:
    pytest.importorskip("ray")
    script = tmp_path / "search.py"
    script.write_text(SEARCH)
    port = free_port()

    def search(study: Path) -> subprocess.Popen[str]:
        environment = {**os.environ, "RAY_ADDRESS": f"127.0.0.1:{port}", "RAY_AUTH_MODE": "disabled"}
        command = [sys.executable, str(script), str(study)]
        return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)

    def table(study: Path) -> list[object]:
        with open_study(study) as view:
            return [(t.trial, t.params, t.seed, t.result) for t in view.trials()]

    heads = [Head(port)]
    mine, alone = tmp_path / "mine" / "study.sqlite", tmp_path / "alone" / "study.sqlite"
    run = search(mine)
    try:
        until(lambda: all((mine.parent / f"trials/{i:04d}/begun").exists() for i in (2, 3)) or run.poll() is not None)
        heads[0].kill()
        words, _ = run.communicate(timeout=120)
        assert run.returncode == 1, words
        assert "the Ray cluster at" in words
        assert "is gone" in words
        assert "the same command goes on" in words
        with open_study(mine) as view:
            assert [t.result is not None for t in view.trials()] == [True, True, False, False]
            assert {a.status for a in view.attempts() if a.trial >= 2} == {"interrupted"}

        heads.append(Head(port))
        for study in (mine, alone):
            study.parent.mkdir(exist_ok=True)
            (study.parent / "go").touch()
            run = search(study)
            words, _ = run.communicate(timeout=120)
            assert run.returncode == 0, words
        assert table(mine) == table(alone)
        assert len(table(mine)) == 5
    finally:
        run.kill()
        for head in heads:
            head.kill()
