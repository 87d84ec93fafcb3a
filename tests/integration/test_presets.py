"""Presets keep the promises of the documentation; options become configuration."""

from __future__ import annotations

import pytest
from locorl.config import config_hash, from_dict, to_dict

from legged_codesign import RunConfig, preset
from legged_codesign.commands.run import Run, parse_bounds, parse_fixed
from legged_codesign.config import SearchConfig


def test_laptop_keeps_its_promises() -> None:
    laptop = preset("laptop")
    assert not laptop.from_scratch
    assert laptop.screen.bodies == 128
    assert laptop.search.trials >= 16
    assert laptop.finetune.iterations >= 12
    tuned = laptop.finetune
    assert tuned.num_envs * tuned.ppo.steps * tuned.iterations == tuned.samples >= 150_000
    assert (laptop.search.confirm, laptop.search.repeats) == (2, 3)
    assert (laptop.deploy.speed, laptop.deploy.seconds) == (0.5, 20.0)
    assert laptop.pretrain.ppo.gamma_reg == 0.98


def test_laptop_is_the_default() -> None:
    assert Run().preset == "laptop"
    assert Run().config() == preset("laptop")


def test_smoke_is_small_and_from_scratch() -> None:
    smoke = preset("smoke")
    assert smoke.from_scratch
    assert smoke.search.trials * smoke.finetune.samples < 100_000
    assert smoke.search.trials > smoke.search.initial, "the Gaussian process must get its turn"


@pytest.mark.parametrize("name", ["smoke", "laptop"])
@pytest.mark.parametrize("objective", ["return", "energy", "cost-of-transport"])
def test_fine_tuning_weighs_power_where_the_search_does(name: str, objective) -> None:
    config = preset(name, objective)
    assert (config.preset, config.objective) == (name, objective)
    weight = config.finetune.specific_power
    assert weight is None if objective == "return" else weight is not None and weight < 0.0


def test_unknown_preset() -> None:
    with pytest.raises(ValueError, match=r"'desktop'.*smoke, laptop, workstation, paper"):
        preset("desktop")


@pytest.mark.parametrize(
    "config",
    [
        preset("smoke"),
        preset("laptop", "return"),
        Run(bounds=("front_shank=1:1.4", "hind_shank=1:1.4"), fix=("front_thigh=1", "hind_thigh=1")).config(),
    ],
    ids=["smoke", "laptop", "shanks only"],
)
def test_configuration_survives_the_disk(config: RunConfig) -> None:
    data = to_dict(config)
    restored = from_dict(RunConfig, data)
    assert restored == config
    assert config_hash(to_dict(restored)) == config_hash(data)


def test_different_runs_have_different_hashes() -> None:
    runs = [Run(), Run(seed=1), Run(objective="return"), Run(trials=20), Run(fix=("front_thigh=1",)), Run("smoke")]
    assert len({config_hash(to_dict(run.config())) for run in runs}) == len(runs)


def test_options_reach_the_configuration() -> None:
    config = Run(
        preset="smoke",
        objective="energy",
        seed=7,
        trials=9,
        iterations=3,
        repeats=8,
        from_scratch=False,
        bounds=("front_shank=1:1.4",),
        fix=("hind_thigh=1",),
    ).config()
    assert (config.objective, config.seed) == ("energy", 7)
    assert (config.search.trials, config.search.repeats, config.finetune.iterations) == (9, 8, 3)
    defaults = preset("smoke", "energy")
    assert Run(preset="smoke", objective="energy").config().search == defaults.search
    assert config.bounds == (("front_shank", 1.0, 1.4),)
    assert config.fixed == (("hind_thigh", 1.0),)
    assert config.from_scratch, "smoke always is"
    assert Run(from_scratch=True).config().from_scratch


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("front_shank=1:1.4", ("front_shank", 1.0, 1.4)),
        ("a=-0.5:.5", ("a", -0.5, 0.5)),
        ("a=1e-3:2e0", ("a", 0.001, 2.0)),
    ],
)
def test_parse_bounds(text: str, expected: tuple[str, float, float]) -> None:
    assert parse_bounds(text) == expected


@pytest.mark.parametrize("text", ["", "a", "a=", "a=1", "a=1:", "a=:1", "a:1=2", "a=1:2:3", "a=b:c"])
def test_parse_bounds_refuses(text: str) -> None:
    with pytest.raises(ValueError, match=r"name=low:high, such as front_shank=1:1\.4"):
        parse_bounds(text)


def test_parse_fixed() -> None:
    assert parse_fixed("front_thigh=1") == ("front_thigh", 1.0)


@pytest.mark.parametrize("text", ["", "a", "a=", "a=b", "a=1=2"])
def test_parse_fixed_refuses(text: str) -> None:
    with pytest.raises(ValueError, match="name=value, such as front_thigh=1"):
        parse_fixed(text)


@pytest.mark.parametrize(("name", "value"), [("trials", 1), ("confirm", 0), ("repeats", 1), ("initial", 0)])
def test_a_search_without_a_comparison_is_refused(name: str, value: int) -> None:
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        SearchConfig(**{name: value})
