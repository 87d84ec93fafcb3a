"""What a training will cost on this machine, before it starts."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import torch

from locorl.training.trainer import Trainer

_ROBOTS, _STEPS, _SECONDS = 256, 32, 0.5
"""Most robots and steps of the trial, and how long it is measured, s."""


@dataclass(frozen=True)
class Cost:
    """A prediction.

    Attributes:
        samples: environment steps still to be taken, by all processes.
        seconds: for them.
        memory: of this process at its peak, bytes; None where the system does not tell.
    """

    samples: int
    seconds: float
    memory: float | None

    def __str__(self) -> str:
        """In words, no more exact than the prediction is."""
        rate = self.samples / self.seconds / 1000
        memory = "" if self.memory is None else f", {max(0.1, self.memory / 1e9):.1f} GB of memory"
        return f"{in_words(self.seconds)} at {rate:.{0 if rate >= 10 else 1}f} k steps/s{memory}"


def predict(trainer: Trainer) -> Cost:
    """What the rest of `trainer`'s run will cost.

    Measured for a second on a small training of its own, with up to 256 of the robots and minibatches as large as the
    run's where so many robots fill them; the run itself is not touched. It leaves out hooks, the auxiliary phases of
    PPG and films. Robots that walk cost a little more or less than robots that have not learnt to, and the machine may
    have other work to do.
    """
    config, env = trainer.config, trainer.env
    iterations = config.iterations - trainer.iteration
    batch = env.num_envs * config.ppo.steps
    rows = max(2, batch // config.ppo.minibatches)
    # on a GPU few robots take as long as many
    robots = min(env.num_envs, _ROBOTS) if env.device.type == "cpu" else env.num_envs
    steps = min(max(2, rows // robots), _STEPS)
    ppo = replace(config.ppo, steps=steps, epochs=1, minibatches=max(1, robots * steps // rows))
    small = replace(config, num_envs=robots, ppo=ppo, network=trainer.policy().card.network)
    before = _peak()
    with torch.random.fork_rng(devices=[]):
        trial = Trainer(env.factory, small, designs=env.bodies.designs[:robots], threads=trainer.threads)
        trial.step()  # the first one is slower
        collect = learn = taken = 0.0
        while collect + learn < _SECONDS:
            row = trial.step()
            collect += row["collect_seconds"]
            learn += row["seconds"] - row["collect_seconds"]
            taken += robots * steps
    after = _peak()
    seconds = iterations * batch * (collect + learn * config.ppo.epochs) / taken
    # what grows with a minibatch has been seen on this many of its rows
    memory = None if before is None or after is None else after + (after - before) * (rows / (robots * steps) - 1.0)
    return Cost(iterations * config.samples_per_iteration, seconds, memory)


def in_words(seconds: float) -> str:
    """A predicted time, rounded to what one can know: `about 25 min`."""
    minutes = seconds / 60
    if minutes < 1:
        return "less than a minute"
    if minutes < 9.5:
        return f"about {round(minutes)} min"
    if minutes < 87.5:
        return f"about {5 * round(minutes / 5)} min"
    hours = minutes / 60
    return f"about {round(2 * hours) / 2:g} h" if hours < 9.75 else f"about {round(hours)} h"


def _peak() -> float | None:
    """Peak resident memory of this process, bytes."""
    if sys.platform == "win32":
        return None
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1.0 if sys.platform == "darwin" else 1024.0)
