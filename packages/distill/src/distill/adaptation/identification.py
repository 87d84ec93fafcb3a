"""How much of a robot's body a latent knows: linear probes on robots that the probe has not seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from distill.adaptation.modules import AdaptationModule
from distill.errors import InterfaceError
from distill.history import HistoryBuffer
from distill.interfaces import StudentEnv, Teacher


@dataclass(frozen=True)
class Identification:
    """Coefficients of determination of linear probes.

    Attributes:
        r2: quantity -> R^2 on held-out robots; 1 is perfect, 0 as good as the mean. NaN where all robots are alike.
        robots: held-out robots.
        samples: latents of them that were judged.
    """

    r2: Mapping[str, float]
    robots: int
    samples: int


@torch.no_grad()
def fit_probe(latent: Tensor, truth: Tensor, ridge: float = 1e-4) -> tuple[Tensor, Tensor]:
    """Weights (L, k) and offsets (k,) of the best linear prediction of `truth` (n, k) from `latent` (n, L).

    Args:
        latent: inputs; a constant one is left out.
        truth: wanted.
        ridge: penalty of the squared weights, per sample, of inputs scaled to variance 1.
    """
    x, y = latent.double(), truth.double()
    mean, centre = x.mean(dim=0), y.mean(dim=0)
    scale = x.std(dim=0, correction=0).clamp(min=1e-9)
    x = (x - mean) / scale
    penalty = ridge * len(x) * torch.eye(x.shape[1], dtype=x.dtype, device=x.device)
    weights = torch.linalg.solve(x.T @ x + penalty, x.T @ (y - centre)) / scale[:, None]
    return weights.to(latent), (centre - mean @ weights).to(latent)


def linear_probe(latent: Tensor, truth: Tensor, train: Tensor, ridge: float = 1e-4) -> Tensor:
    """Predict `truth` linearly from `latent`, and judge the prediction on other samples.

    Args:
        latent: (n, L).
        truth: (n, k).
        train: (n,) bool, samples that the probe is fitted to; it is judged on the others.
        ridge: see `fit_probe`.

    Returns:
        R^2 (k,) = 1 - (squared error / squared deviation from the judged samples' mean); NaN for a constant.

    Raises:
        ValueError: there is nothing to fit to, or nothing to judge on.
    """
    if not train.any() or train.all():
        raise ValueError("a probe needs samples to be fitted to and others to be judged on")
    x, y = latent.double(), truth.double()
    weights, offsets = fit_probe(x[train], y[train], ridge)
    judged = y[~train]
    error = (judged - x[~train] @ weights - offsets).square().sum(dim=0)
    spread = (judged - judged.mean(dim=0)).square().sum(dim=0)
    # a constant in single precision leaves rounding behind
    constant = spread <= 1e-10 * judged.square().sum(dim=0).clamp(min=1e-12)
    return torch.where(constant, torch.nan, 1.0 - error / spread)


@torch.no_grad()
def identify(
    env: StudentEnv,
    teacher: Teacher,
    adaptation: AdaptationModule,
    columns: Mapping[str, slice],
    steps: int = 200,
    settle: int = 50,
    seed: int = 0,
    held_out: float = 0.25,
) -> Identification:
    """Report how well the history latent identifies what the robots are told of their bodies.

    Args:
        env: robots with different bodies, each with the same one throughout.
        teacher: acts.
        adaptation: whose history encoder is judged.
        columns: quantity -> its columns in the group "implicit"; wide ones are reported element by element.
        steps: control steps.
        settle: first steps that are left out.
        seed: of the episodes.
        held_out: share of the robots that the probe is judged on.

    Raises:
        InterfaceError: the environment shows no implicit state, or has too few robots.
    """
    dims = env.group_dims
    if "implicit" not in dims:
        raise InterfaceError(f"identification needs the observation group 'implicit'; there are {sorted(dims)}")
    judged = round(held_out * env.num_envs)
    if not 1 < judged < env.num_envs - adaptation.latent_dim or settle >= steps:
        raise InterfaceError(
            f"{env.num_envs} robots are too few to fit a probe of {adaptation.latent_dim} inputs and judge it on "
            f"{judged} others, or settle {settle} leaves nothing of {steps} steps"
        )
    history = HistoryBuffer(env.num_envs, adaptation.config.history, adaptation.proprio, env.device)
    obs = env.reset(seed=seed)
    latents, truths = [], []
    for step in range(steps):
        history.update(adaptation.push(history.frames, obs["proprio"]))
        if step >= settle:
            latents.append(adaptation.latent(history.frames))
            truths.append(obs["implicit"].clone())
        obs, _, terminated, truncated, _ = env.step(teacher.act(obs))
        history.reset(terminated | truncated)
    order = torch.randperm(env.num_envs, generator=torch.Generator().manual_seed(seed)).to(env.device)
    robots = order < env.num_envs - judged
    train = robots.repeat(len(latents))
    r2 = linear_probe(torch.cat(latents), torch.cat(truths), train).tolist()
    names = {name: r2[place] for name, place in columns.items()}
    return Identification(dict(_spelt_out(names)), judged, len(latents) * judged)


def _spelt_out(values: Mapping[str, list[float]]) -> Iterator[tuple[str, float]]:
    for name, column in values.items():
        if len(column) == 1:
            yield name, column[0]
        else:
            yield from ((f"{name}[{index}]", value) for index, value in enumerate(column))
