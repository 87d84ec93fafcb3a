"""Which checkpoint a run goes on from, and which it refuses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import rich

from locorl import checkpoint
from locorl.bodies.family import BodyFamily
from locorl.config import config_hash, differences, from_dict, to_dict
from locorl.learning.policy import PolicyCard
from locorl.training.config import TrainConfig


def identity(config: Mapping[str, Any]) -> dict[str, Any]:
    """What of a configuration, as JSON data, must stay the same for a run to go on.

    Of the simulator that is its backend and the kind of device: a run of one GPU goes on on any other, but not on a
    CPU, whose random streams are others. Threads and room for contacts may change. Runs that were written down before
    there was a choice used the CPU.
    """
    simulator = config.get("simulator", {"backend": "cpu", "device": "cpu"})
    kept = {"backend": simulator["backend"], "device": simulator["device"].partition(":")[0]}
    return {**config, "simulator": kept}


def read_checkpoint(path: Path, config: TrainConfig, quiet: bool = False) -> Mapping[str, Any] | None:
    """The newest readable checkpoint at `path`, None if there is none; says so if it is not the last one written.

    Args:
        path: of the newest; the one before lies beside it.
        config: of the run that wants to go on.
        quiet: say nothing.

    Raises:
        checkpoint.CheckpointError: it belongs to another configuration, or there is none that can be read.
    """
    found = checkpoint.load_newest(path)
    if found is None:
        return None
    content, warning = found
    if "config" not in content:
        raise checkpoint.CheckpointError(f"{path} holds a policy but no training to resume; use another folder")
    # the run is the same if it is longer or saves at other times, unless the bodies share the iterations out
    free = {"save_every"} if config.morphology.kind == "temporal" else {"save_every", "iterations"}
    theirs, mine = (
        {name: value for name, value in identity(each).items() if name not in free}
        for each in (content["config"], to_dict(config))
    )
    if config_hash(theirs) != config_hash(mine):
        raise checkpoint.CheckpointError(
            f"{path} belongs to another configuration; use another folder. Differences:\n  "
            + "\n  ".join(differences(theirs, mine))
        )
    if warning and not quiet:
        rich.get_console().print(f"{warning}, of iteration {content['iteration']}", highlight=False, soft_wrap=True)
    return content


def check_origin(content: Mapping[str, Any], card: PolicyCard, samples: int, folder: Path | None) -> None:
    """Refuse a checkpoint of another robot or family of bodies, or of a run that started from another policy.

    Args:
        content: of the checkpoint.
        card: of the run's policy as it starts.
        samples: taken by the run until the checkpoint.
        folder: of the run, for the message.

    Raises:
        checkpoint.CheckpointError: with the differences.
    """
    there = dict(content["card"])
    told = there.pop("family", None)  # cards of earlier formats do not tell
    changes = differences(there, to_dict(replace(card, samples=card.samples + samples, family=None)))
    if told is not None and card.family is not None:
        changes += from_dict(BodyFamily, told).differences(card.family)
    if changes:
        raise checkpoint.CheckpointError(
            f"{folder}: the checkpoint belongs to another robot or another starting policy; use another folder. "
            "Differences:\n  " + "\n  ".join(changes)
        )
