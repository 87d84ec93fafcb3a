"""locorl: simulate thousands of different legged bodies at once and train one policy for all of them."""

import os

# torch's idle OpenMP threads spin for milliseconds on the cores that the simulator's threads need, unless told
# not to before torch is loaded
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from locorl.bodies.designs import design_grid, feasible, repeat_design, sample_designs, sobol_designs
from locorl.bodies.samplers import MorphologyConfig, MorphologySampler, make_sampler
from locorl.checkpoint import CheckpointError
from locorl.env.commands import CommandConfig
from locorl.env.depth_camera import DepthCamera, DepthConfig
from locorl.env.goals import GoalConfig
from locorl.env.legged_env import LeggedEnv
from locorl.env.observation import ObservationConfig
from locorl.env.randomisation import RandomisationConfig, no_randomisation
from locorl.env.scan import ScanConfig
from locorl.env.step_info import StepInfo
from locorl.env.symmetry import Symmetry
from locorl.evaluation.evaluate import Course, EvalConfig, Evaluation, evaluate
from locorl.evaluation.fitness import gains
from locorl.evaluation.gait import Gait
from locorl.evaluation.obstacles import ObstacleBin, success_by_obstacle
from locorl.learning.config import PPGConfig
from locorl.learning.hooks import RolloutHook
from locorl.learning.networks import ActorCritic, NetworkConfig
from locorl.learning.policy import Policy, PolicyCard, load_policy
from locorl.learning.ppo import PPO, DivergedError, PPOConfig
from locorl.providers import find_factory
from locorl.rewards.config import RewardConfig, released_code, table_i
from locorl.rewards.state import StepState
from locorl.simulation.make import SimulatorConfig
from locorl.simulation.scene import PhysicsConfig, flat_scene
from locorl.simulation.simulator import Simulator
from locorl.tasks import TASKS, TaskConfig, make_task
from locorl.terrain.curriculum import CurriculumConfig
from locorl.terrain.map import TerrainConfig, TerrainMap
from locorl.training.finetune import FinetuneConfig, Finetuned, finetune
from locorl.training.metrics import read_metrics
from locorl.training.trainer import TrainConfig, Trainer

__all__ = [
    "PPO",
    "TASKS",
    "ActorCritic",
    "CheckpointError",
    "CommandConfig",
    "Course",
    "CurriculumConfig",
    "DepthCamera",
    "DepthConfig",
    "DivergedError",
    "EvalConfig",
    "Evaluation",
    "FinetuneConfig",
    "Finetuned",
    "Gait",
    "GoalConfig",
    "LeggedEnv",
    "MorphologyConfig",
    "MorphologySampler",
    "NetworkConfig",
    "ObservationConfig",
    "ObstacleBin",
    "PPGConfig",
    "PPOConfig",
    "PhysicsConfig",
    "Policy",
    "PolicyCard",
    "RandomisationConfig",
    "RewardConfig",
    "RolloutHook",
    "ScanConfig",
    "Simulator",
    "SimulatorConfig",
    "StepInfo",
    "StepState",
    "Symmetry",
    "TaskConfig",
    "TerrainConfig",
    "TerrainMap",
    "TrainConfig",
    "Trainer",
    "design_grid",
    "evaluate",
    "feasible",
    "find_factory",
    "finetune",
    "flat_scene",
    "gains",
    "load_policy",
    "make_sampler",
    "make_task",
    "no_randomisation",
    "read_metrics",
    "released_code",
    "repeat_design",
    "sample_designs",
    "sobol_designs",
    "success_by_obstacle",
    "table_i",
]
