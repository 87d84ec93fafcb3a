"""What a training that produced NaN leaves behind, and how to see it happen again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from locorl import checkpoint
from locorl.config import from_dict
from locorl.interfaces import BodyFactory
from locorl.learning.hooks import RolloutHook
from locorl.learning.policy import policy_from
from locorl.providers import find_factory
from locorl.training.trainer import TrainConfig, Trainer


def replay(
    path: Path,
    factory: BodyFactory | None = None,
    hooks: Sequence[RolloutHook] = (),
    threads: int | None = None,
) -> dict[str, float]:
    """Repeat the iteration that stopped a training, from the `fault.pt` that it left.

    The dump is a checkpoint of just before that iteration's rollout (bodies, environment, networks, optimiser, random
    streams) with the error's message, so the iteration takes the same course: it raises the same error. Put a
    breakpoint where you like.

    Args:
        path: the dump.
        factory: makes the bodies; by default the installed robot of the dump's name.
        hooks: those of the training.
        threads: simulation threads.

    Returns:
        The metrics of the iteration if it went well this time, as when the cause has been mended.

    Raises:
        ppo.DivergedError: it happened again.
        checkpoint.CheckpointError: there is no such dump, or it cannot be read.
        LookupError: the robot is not installed.
    """
    content = checkpoint.load(path)
    if "fault" not in content:
        raise checkpoint.CheckpointError(f"{path} is no dump of a fault; a training that meets NaN leaves fault.pt")
    card, designs = policy_from(content, path).card, content["designs"].numpy()
    config = replace(from_dict(TrainConfig, content["config"]), num_envs=len(designs), network=card.network)
    trainer = Trainer(factory or find_factory(card.robot), config, designs=designs, threads=threads, hooks=hooks)
    trainer.restore(content)
    return trainer.step()
