"""locorl: simulate thousands of different legged bodies at once and train one policy for all of them."""

from locorl.bodies.designs import design_grid, feasible, repeat_design, sample_designs
from locorl.env.commands import CommandConfig
from locorl.env.legged_env import LeggedEnv, StepInfo
from locorl.env.randomisation import RandomisationConfig, no_randomisation
from locorl.learning.checkpoint import CheckpointError
from locorl.learning.evaluate import EvalConfig, Evaluation, evaluate
from locorl.learning.finetune import FinetuneConfig, Finetuned, finetune
from locorl.learning.networks import ActorCritic, NetworkConfig
from locorl.learning.policy import Policy, PolicyCard, load_policy
from locorl.learning.ppo import PPO, DivergedError, PPOConfig
from locorl.learning.train import TrainConfig, Trainer
from locorl.rewards.config import RewardConfig, released_code, table_i
from locorl.simulation.scene import PhysicsConfig, flat_scene
from locorl.tasks.task import TaskConfig

__all__ = [
    "PPO",
    "ActorCritic",
    "CheckpointError",
    "CommandConfig",
    "DivergedError",
    "EvalConfig",
    "Evaluation",
    "FinetuneConfig",
    "Finetuned",
    "LeggedEnv",
    "NetworkConfig",
    "PPOConfig",
    "PhysicsConfig",
    "Policy",
    "PolicyCard",
    "RandomisationConfig",
    "RewardConfig",
    "StepInfo",
    "TaskConfig",
    "TrainConfig",
    "Trainer",
    "design_grid",
    "evaluate",
    "feasible",
    "finetune",
    "flat_scene",
    "load_policy",
    "no_randomisation",
    "released_code",
    "repeat_design",
    "sample_designs",
    "table_i",
]
