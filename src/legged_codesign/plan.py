"""What a run would do, before it does it: every number with its source, and the predicted cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from locorl.config import leaves, to_dict
from morphgen import BodyFactory, DesignSpace
from rich.console import Console
from rich.table import Table

from legged_codesign.config import RunConfig
from legged_codesign.machines import Machines
from legged_codesign.predict import predict
from legged_codesign.presets import HARDWARE_BOUNDS, HARDWARE_FIXED, preset
from legged_codesign.tasks import find_task

_REFERENCE = "legged_gym and Extreme Parkour, on which the authors build"
_RELEASED = "the authors' released code"

_OURS = "ours"
_COMMAND = "the command"

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
    "pretrain.task.observation.proprio": f"section III-A1; commands and contacts: {_REFERENCE}",
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
    "finetune.num_envs": _RELEASED,
    "finetune.iterations": "section IV-B4",
    "finetune.ppo.gamma_reg": "Table III",
    "finetune.ppo.regulariser": "section III-B2",
    "finetune.ppo": _RELEASED,
    "score.robots": "section IV-C2",
    "distil.depth": "section III-D",
    "distil.adapt.schedule": f"section III-D; numbers: {_REFERENCE}",
    "distil.adapt.networks.estimator_frames": "section III-D",
    "distil.adapt.finetune.iterations": "section IV-B4",
    "distil.adapt.finetune.num_envs": _RELEASED,
    "distil.adapt.finetune.ppo.gamma_reg": "Table III",
    "distil.adapt.finetune.ppo.regulariser": "section III-B2",
    "distil.adapt.finetune.ppo": _RELEASED,
    "distil.vision.mts": "section III-D",
    "distil.vision.roa": "section III-D",
    "distil.vision": _REFERENCE,
    "distil.vision_student.depth": f"Fig. 3; sizes: {_REFERENCE}",
    "distil.vision_student.latency": _REFERENCE,
    "distil.vision_student.heading_limit": _REFERENCE,
    "distil.vision_student.terrain_dim": _REFERENCE,
    "distil.vision_student.latent_dim": _REFERENCE,
    "distil.camera": _REFERENCE,
    "distil.camera.period": "section IV-C1",
    "deploy.seconds": "Fig. 9",
    # within those groups
    **dict.fromkeys(
        (
            "pretrain.task.name",
            "pretrain.task.terrain.columns",
            "pretrain.task.terrain.relief_cell",
            "pretrain.task.terrain.border",
            "pretrain.task.terrain.seed",
            "pretrain.task.curriculum.least",
            "pretrain.task.curriculum.hip_limit",
            "pretrain.task.randomisation.reset_joint",
            "pretrain.task.randomisation.reset_velocity",
            "pretrain.task.randomisation.reset_position",
            "pretrain.task.randomisation.stagger",
            "pretrain.task.physics.solver_iterations",
            "pretrain.task.physics.linesearch_iterations",
            "pretrain.task.physics.elliptic_cone",
            # Table I does not use them, or leaves them open
            "pretrain.task.reward.linear_scale",
            "pretrain.task.reward.angular_scale",
            "pretrain.task.reward.swing_height",
            "pretrain.task.reward.clip_at_zero",
            # of the regularisers to compare with
            *(
                f"{stage}.ppo.{name}"
                for stage in ("pretrain", "finetune", "distil.adapt.finetune")
                for name in ("activation_weight", "v_max", "ppg")
            ),
            "pretrain.network.min_std",
            "distil.adapt.schedule.warmup",
            "distil.vision.segment",
            "distil.vision.seed",
            "distil.vision.final_rate",
            "distil.vision.batch",
            "distil.vision.terrain_weight",
            "distil.vision.velocity_weight",
            "distil.camera.edge_jump",
        ),
        _OURS,
    ),
}
"""Where the numbers of the preset `paper` come from, by the longest prefix of their names; the others are ours."""
_CHOICES: Mapping[str, Mapping[str, str]] = {
    "task": {
        **dict.fromkeys(("steps", "hills", "highjump", "longjump"), "section IV-A2"),
        "slope": "section IV-C",
        "stones": _RELEASED,
    },
    "objective": {"return": "eq. 9", "energy": "eq. 10"},
    "search.method": {"codesign-bo": "Algorithm 2", "hyperopt-tpe": "section IV-A2"},
    "pretrain.task.terrain.kinds": {
        **dict.fromkeys(("hills", "steps_up", "steps_down", "hurdles", "platforms", "long_jump"), "section IV-A2"),
        **dict.fromkeys(("slope_up", "slope_down"), "section IV-C"),
        "tilted_stones": _RELEASED,
    },
}
"""Where a choice comes from, whatever the preset chooses; the others are ours."""


@dataclass(frozen=True)
class Setting:
    """One number of a run.

    Attributes:
        name: path in the configuration; `search within.` and a design parameter for its bounds, or what it is held at.
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
    # for energy the preset weighs power in the reward as well, which the paper does not
    paper = dict(leaves(to_dict(preset("paper", "return", config.task))))
    # morphgen's defaults for its own robots are the paper's
    paper |= {"bodies.rule": "paper", "body.kp": 40.0, "body.kd": 0.7, "body.low": [0.6] * 4, "body.high": [1.4] * 4}
    values = {**dict(leaves(to_dict(config))), "bodies.rule": factory.rule, **body}
    del values["bounds"], values["fixed"]
    sources = {**SOURCES, **_sources_by_task(config)}
    listed = [Setting(name, value, _source(name, value, paper.get(name), sources)) for name, value in values.items()]
    return [*listed, *_bounds(config, space)]


def print_plan(config: RunConfig, factory: BodyFactory, machines: Machines, console: Console) -> None:
    """Print all settings and the predicted cost."""
    table = Table(title=f"codesign run, preset {config.preset}", title_justify="left")
    for column in ("setting", "value", "source"):
        table.add_column(column, overflow="fold")
    for setting in settings(config, factory):
        table.add_row(setting.name, _short(setting.value), setting.source)
    console.print(table)
    console.print(f"predicted: {predict(config, factory, machines)}", highlight=False, soft_wrap=True)


def _bounds(config: RunConfig, space: DesignSpace) -> list[Setting]:
    """What each design parameter is searched within, or held at."""
    given: dict[str, object] = {name: [low, high] for name, low, high in config.bounds}
    given |= dict(config.fixed)
    built: dict[str, object] = {name: [low, high] for name, low, high in HARDWARE_BOUNDS}
    built |= dict(HARDWARE_FIXED)
    if config.robot != "go2":
        built = {}  # no other robot was built
    simulated = {name: [0.6, 1.4] for name in DesignSpace.leg_scales().names}
    found = []
    for name, low, high in zip(space.names, space.low.tolist(), space.high.tolist(), strict=True):
        value = given.get(name, [low, high])
        if name in given and value == built.get(name):
            source = "section IV-C1"
        elif value == simulated.get(name):
            source = "section IV-A1"
        else:
            source = _COMMAND if name in given else _OURS
            source += f"; {_short(simulated[name])} by section IV-A1" if name in simulated else ""
        found.append(Setting(f"search within.{name}", value, source))
    return found


def _sources_by_task(config: RunConfig) -> Mapping[str, str]:
    # Extreme Parkour starts along the course and turns at another gain, legged_gym never starts turned
    ours = "command.heading_gain" if find_task(config.task).parkour else "randomisation.reset_yaw"
    return {f"pretrain.task.{ours}": _OURS}


def _source(name: str, value: object, papers: object, sources: Mapping[str, str]) -> str:
    if name in _CHOICES:
        chosen = value if isinstance(value, list) else [value]
        return "; ".join(dict.fromkeys(_CHOICES[name].get(str(each), _OURS) for each in chosen))
    prefixes = [prefix for prefix in sources if name == prefix or name.startswith(f"{prefix}.")]
    source = sources[max(prefixes, key=len)] if prefixes else _OURS
    return source if value == papers or source == _OURS else f"{_OURS}; {_short(papers)} by {source}"


def _short(value: object) -> str:
    if isinstance(value, list):
        return "(" + ", ".join(map(_short, value)) + ")" if value else "none"
    if isinstance(value, float):
        return f"{value:g}"
    return "none" if value is None else str(value)
