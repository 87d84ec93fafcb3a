"""What a run would do, before it does it: every number with its source, and the predicted cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from locorl.config import leaves, to_dict
from morphgen import BodyFactory
from rich.console import Console
from rich.table import Table

from legged_codesign.config import RunConfig
from legged_codesign.machines import Machines
from legged_codesign.predict import predict
from legged_codesign.presets import preset

_REFERENCE = "legged_gym and Extreme Parkour, on which the authors build"
_RELEASED = "the authors' released code"

SOURCES: Mapping[str, str] = {
    "robot": "section IV-A2",
    "bodies.rule": "Table II",
    "bodies.space": "section III-B1",
    "bodies.gains": _RELEASED,
    "body.kp": "section IV-A2",
    "body.kd": "section IV-A2",
    "body.low": "section IV-A1",
    "body.high": "section IV-A1",
    "pretrain.num_envs": _RELEASED,
    "pretrain.iterations": "section IV-B4",
    "pretrain.morphology.kind": "section III-B1",
    "pretrain.task.terrain": _REFERENCE,
    "pretrain.task.curriculum": _REFERENCE,
    "pretrain.task.observation": "section III-A1",
    "pretrain.task.observation.scan": _REFERENCE,
    "pretrain.task.observation.history": _REFERENCE,
    "pretrain.task.observation.perception_period": "section IV-C1",
    "pretrain.task.reward": "Table I",
    "pretrain.task.physics.timestep": _REFERENCE,
    "pretrain.task.physics.substeps": "section IV-C1: 50 Hz",
    "pretrain.task": _REFERENCE,
    "pretrain.ppo.gamma_reg": "Table III",
    "pretrain.ppo.regulariser": "section III-B2",
    "pretrain.ppo": _RELEASED,
    "pretrain.network": f"Fig. 3; sizes: {_REFERENCE}",
    "search.trials": "section IV-A2",
    "search.repeats": "section IV-A2",
    "search.method": "Algorithm 2",
    "finetune.num_envs": _RELEASED,
    "finetune.iterations": "section IV-B4",
    "finetune.ppo.gamma_reg": "Table III",
    "finetune.ppo.regulariser": "section III-B2",
    "finetune.ppo": _RELEASED,
    "score.robots": "section IV-C2",
    "distil.depth": "section III-D",
    "distil.adapt.schedule": f"section III-D; numbers: {_REFERENCE}",
    "distil.adapt.finetune.iterations": "section IV-B4",
    "distil.adapt.finetune.num_envs": _RELEASED,
    "distil.adapt.finetune.ppo": _RELEASED,
    "distil.vision.mts": "section III-D",
    "distil.vision.roa": "section III-D",
    "distil.vision": _REFERENCE,
    "distil.vision_student": f"Fig. 3; sizes: {_REFERENCE}",
    "distil.robots": _REFERENCE,
    "distil.camera": _REFERENCE,
    "deploy.seconds": "Fig. 9",
}
"""Where the numbers of the preset `paper` come from, by the longest prefix of their names; the others are ours."""
TASK_SOURCES: Mapping[str, str] = {
    **dict.fromkeys(("steps", "hills", "highjump", "longjump"), "section IV-A2"),
    "slope": "section IV-C",
    "stones": _RELEASED,
}
OBJECTIVE_SOURCES: Mapping[str, str] = {"return": "eq. 9", "energy": "eq. 10"}
"""Where tasks and objectives come from, whatever the preset; the others are ours."""
_OURS = (
    "pretrain.task.name",
    "pretrain.task.physics.solver_iterations",
    "pretrain.task.physics.linesearch_iterations",
    "pretrain.task.physics.elliptic_cone",
    "pretrain.task.terrain.relief_cell",
    "pretrain.task.terrain.border",
    "pretrain.task.terrain.seed",
    "distil.vision.segment",
    "distil.vision.seed",
)
"""Numbers within a sourced group that are ours even there."""


@dataclass(frozen=True)
class Setting:
    """One number of a run.

    Attributes:
        name: path in the configuration.
        value: of it.
        source: where it comes from; `ours` unless the paper's preset has the same value from somewhere.
    """

    name: str
    value: object
    source: str


def settings(config: RunConfig, factory: BodyFactory) -> list[Setting]:
    """Every number of a run, with its source."""
    drive, space = factory.drive, factory.space
    body = {"body.kp": drive.kp, "body.kd": drive.kd, "body.low": space.low.tolist(), "body.high": space.high.tolist()}
    paper = dict(leaves(to_dict(preset("paper", config.objective, config.task))))
    # morphgen's defaults are the paper's
    paper |= {"body.kp": 40.0, "body.kd": 0.7, "body.low": [0.6] * 4, "body.high": [1.4] * 4}
    task = TASK_SOURCES.get(config.task, "ours")
    chosen = {"task": task, "objective": OBJECTIVE_SOURCES.get(config.objective, "ours")}
    sources = {**SOURCES, **chosen, "pretrain.task.terrain.kinds": task}
    return [
        Setting(name, value, _source(name, value, paper.get(name), sources))
        for name, value in {**dict(leaves(to_dict(config))), **body}.items()
    ]


def print_plan(config: RunConfig, factory: BodyFactory, machines: Machines, console: Console) -> None:
    """Print all settings and the predicted cost."""
    table = Table(title=f"codesign run, preset {config.preset}", title_justify="left")
    for column in ("setting", "value", "source"):
        table.add_column(column, overflow="fold")
    for setting in settings(config, factory):
        table.add_row(setting.name, _short(setting.value), setting.source)
    console.print(table)
    console.print(f"predicted: {predict(config, factory, machines)}", highlight=False, soft_wrap=True)


def _source(name: str, value: object, papers: object, sources: Mapping[str, str]) -> str:
    prefixes = [prefix for prefix in sources if name == prefix or name.startswith(f"{prefix}.")]
    if not prefixes or name in _OURS:
        return "ours"
    source = sources[max(prefixes, key=len)]
    return source if value == papers or source == "ours" else f"ours; {_short(papers)} by {source}"


def _short(value: object) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(map(_short, value)) + ")" if value else "none"
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value is None else str(value)
