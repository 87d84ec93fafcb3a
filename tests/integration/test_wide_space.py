"""Robots and design spaces beyond the built-in ones: what morphgen makes, locorl simulates and codesign_bo searches."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from codesign_bo import BoxSpace, Study
from codesign_bo.interfaces import EvalResult
from locorl import LeggedEnv, TaskConfig, sample_designs
from locorl.providers import find_factory
from morphgen import BodyFactory, DesignSpace, from_urdf, load_robot


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A vendor-like file of a user."""
    path = tmp_path_factory.mktemp("robot") / "mine.urdf"
    path.write_text(load_robot("lite3", rule="stretch").urdf(np.ones(4)), encoding="utf-8")
    return path


@pytest.fixture(
    params=[
        lambda file: find_factory("lite3"),
        lambda file: find_factory(str(file)),
        lambda file: from_urdf(
            file, rule="lumped", space=DesignSpace.of(front_thigh=(0.8, 1.2), motor_placement=(0, 1))
        ),
        lambda file: load_robot("go2", rule="stretch", space=DesignSpace.wide()),
        lambda file: load_robot("go2", space=DesignSpace.per_leg()),
    ],
    ids=["lite3", "file", "motor", "wide", "per leg"],
)
def factory(request: pytest.FixtureRequest, file: Path) -> BodyFactory:
    return request.param(file)


def test_locorl_simulates_its_bodies(factory: BodyFactory) -> None:
    designs = sample_designs(factory, 8, np.random.default_rng(3))
    env = LeggedEnv(factory, designs, TaskConfig(), seed=0, threads=1)
    env.reset()
    for _ in range(25):
        _, reward, *_ = env.step(torch.zeros(8, 12))
        assert torch.isfinite(reward).all()
    # half a second of holding the stance, pushes and noise included: nobody falls
    height = env.sim.qpos[:, 2].numpy() / factory.batch(designs).stance_qpos[:, 2]
    assert np.all((height > 0.8) & (height < 1.15))


def test_codesign_bo_searches_its_space(factory: BodyFactory, tmp_path: Path) -> None:
    """For the lightest body that can stand."""
    own = factory.space
    space = BoxSpace.box(list(own.names), list(own.low), list(own.high), list(own.nominal))

    def feasible(designs: np.ndarray) -> np.ndarray:
        return factory.feasible(designs)

    masses = []
    study = Study(space, tmp_path / "study.sqlite", seed=1, n_init=4, feasible=feasible)
    for _ in range(6):
        (request,) = study.ask()
        design = np.array([request.params[name] for name in own.names])
        assert own.contains(design).all()
        assert feasible(design[None]).all()
        masses.append(float(factory.skeleton(design).total_mass[0]))
        study.tell(request.trial, EvalResult(mean=-masses[-1], sem=1e-3))
    study.close()
    assert masses[0] == pytest.approx(factory.batch(own.nominal).total_mass[0])
    assert min(masses[4:]) < masses[0]
