"""The generalist of a run: trained here, by one process or several, or the one that ships.

Several processes, one for each GPU, are those of torchrun, which this module is the program of:

    torchrun --nproc-per-node 4 -m legged_codesign.pretrain runs/paper-go2-steps-return

Those that a run starts end with it, even if it is killed: they would go on training in a folder that another run holds.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import torch
from locorl import Policy, Trainer, load_policy
from locorl.learning.distributed import Processes
from morphgen import BodyFactory

from legged_codesign.config import RunConfig
from legged_codesign.pretrained import shipped_policy
from legged_codesign.robots import body_factory
from legged_codesign.run_folder import Files, read_config
from legged_codesign.stages import RunError
from legged_codesign.tasks import find_task, searched_task

_TRAINED = "policy.pt"
_LED = "--led"
"""The standard input is a pipe that ends with the run."""


def pretrain(config: RunConfig, files: Files, processes: int = 1) -> None:
    """Write the generalist on the run's own task to `files.generalist`.

    Args:
        config: the run.
        files: of the run, whose config.yaml is written.
        processes: that train together.

    Raises:
        RunError: one of several processes failed.
    """
    if not config.from_scratch:
        policy = load_policy(shipped_generalist(config))
    elif processes == 1:
        policy = train(config, files)
    else:
        _train_together(files, processes)
        policy = load_policy(files.training / _TRAINED)
    task = searched_task(config.task, policy.card.task)
    Policy(policy.model, replace(policy.card, task=task)).save(files.generalist)


def train(config: RunConfig, files: Files, group: Processes | None = None) -> Policy:
    """Train the generalist, or the rest of it."""
    factory = body_factory(config.robot, config.bodies)
    trainer = Trainer(factory, config.pretrain, files.training, group=group)
    trainer.run("pre-train")
    return trainer.policy()


def shipped_generalist(config: RunConfig) -> Path:
    """Path of the policy that ships for the run's robot and task.

    Raises:
        FileNotFoundError: there is none; pre-train with `--from-scratch`.
    """
    return shipped_policy(config.robot, find_task(config.task).shipped)


def check_shipped(config: RunConfig, factory: BodyFactory) -> None:
    """Refuse a run that starts from a shipped generalist, if none ships for its bodies.

    Raises:
        FileNotFoundError: no generalist ships for robot and task.
        ValueError: it was trained on another design space, by another scaling rule, or with constant gains.
    """
    if config.from_scratch:
        return
    if config.bodies.rule not in (None, "paper"):
        raise ValueError(
            f"the generalist that ships was trained on bodies of the rule 'paper', not '{config.bodies.rule}'; "
            "--from-scratch trains one for it"
        )
    if config.bodies.gains != "none":
        raise ValueError(
            f"the generalist that ships was trained with constant gains, not with '{config.bodies.gains}'; "
            "--from-scratch trains one for it"
        )
    try:
        load_policy(shipped_generalist(config)).check_bodies(factory, "train one for these")
    except ValueError as error:
        raise ValueError(f"{error}: --from-scratch does") from error


def _train_together(files: Files, processes: int) -> None:
    program = ["-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={processes}"]
    command = [sys.executable, *program, "-m", "legged_codesign.pretrain", str(files.folder), _LED]
    with subprocess.Popen(command, stdin=subprocess.PIPE) as training:
        try:
            code = training.wait()
        except BaseException:  # Ctrl-C: to close the pipe ends the others, and `with` waits for them
            training.terminate()
            raise
    if code:
        raise RunError(
            f"pre-training with {processes} processes ended with code {code}; what they printed stands above"
        )


def _end_with_run() -> None:
    """End this process when the standard input does, whatever it is doing."""

    def wait() -> None:
        while os.read(sys.stdin.fileno(), 4096):
            pass
        os._exit(1)  # the main thread may be waiting for the other processes, and hear nothing

    threading.Thread(target=wait, daemon=True).start()


def main() -> None:
    """Entry point of each of several processes."""
    if sys.argv[2:] == [_LED]:
        _end_with_run()
    files = Files(Path(sys.argv[1]))
    config = read_config(files.folder)
    device = config.pretrain.simulator.device
    group = Processes.from_environment(device if torch.device(device).type == "cuda" else "cpu")
    policy = train(config, files, group)
    if group is None or group.first:
        policy.save(files.training / _TRAINED)  # a training that had ended before does not write it again


if __name__ == "__main__":
    main()
