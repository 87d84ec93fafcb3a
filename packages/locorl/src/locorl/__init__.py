"""locorl: simulate thousands of different legged bodies at once and train one policy for all of them."""

from locorl.bodies import design_grid, feasible, repeat_design, sample_designs
from locorl.checkpoint import CheckpointError
from locorl.env import LeggedEnv, StepInfo
from locorl.evaluate import EvalConfig, Evaluation, evaluate
from locorl.finetune import FinetuneConfig, Finetuned, finetune
from locorl.networks import ActorCritic, NetworkConfig
from locorl.policy import Policy, PolicyCard, load_policy
from locorl.ppo import PPO, DivergedError, PPOConfig
from locorl.rewards import RewardConfig, table_i
from locorl.scene import PhysicsConfig, flat_scene
from locorl.task import CommandConfig, RandomisationConfig, TaskConfig, no_randomisation
from locorl.train import TrainConfig, Trainer

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
    "repeat_design",
    "sample_designs",
    "table_i",
]
