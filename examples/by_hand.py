"""The packages composed by hand, for a robot and a reward term of your own: python by_hand.py --urdf mine.urdf"""

from pathlib import Path

import deploy
import distill
import locorl
import numpy as np
import tyro
from codesign_bo import BoxSpace, EvalRequest, EvalResult, Study
from morphgen import from_urdf

from legged_codesign.bundle import bundle_spec


def hard_landing(state: locorl.StepState, _: locorl.RewardConfig):  # a term of your own, (robots,)
    return (state.landed * state.foot_force.norm(dim=-1)).sum(dim=1) / 100.0


def main(urdf: Path, folder: Path = Path("runs/by-hand"), robots: int = 1024, iterations: int = 160, trials: int = 16):
    robot = from_urdf(urdf)
    task = locorl.TaskConfig(reward=locorl.RewardConfig(own=(("by_hand:hard_landing", -0.05),)))
    trainer = locorl.Trainer(robot, locorl.TrainConfig(robots, iterations, task=task), folder / "pretrain")
    trainer.run()  # the generalist

    def score(request: EvalRequest) -> EvalResult:  # fine-tune it to one body, then measure eq. 9
        design, tune = np.array(list(request.params.values())), locorl.FinetuneConfig(robots // 2, iterations // 15 + 1)
        policy = locorl.finetune(trainer.policy(), robot, design, tune, request.seed).policy
        policy.save(request.workdir / "policy.pt")
        returns = locorl.evaluate(policy, robot, design[None], task, locorl.EvalConfig(robots_per_body=32)).returns
        return EvalResult(float(returns.mean()), float(returns.std(ddof=1)) / 32**0.5, 32)

    limits, folder = robot.space, folder.resolve()
    space = BoxSpace.box(limits.names, *(each.tolist() for each in (limits.low, limits.high, limits.nominal)))
    with Study(space, folder / "study.sqlite", feasible=lambda designs: locorl.feasible(robot, designs)) as study:
        study.run(score, until=trials)
        study.confirm(score, top_k=2, repeats=3)
        best = study.recommend()
    teacher = locorl.load_policy(folder / f"trials/{best.trial:04d}/policy.pt")
    design = np.array(list(best.params.values()))
    env = locorl.LeggedEnv(robot, np.tile(design, (robots // 4, 1)), task)
    student = distill.train(env, teacher, folder / "student")
    distill.export_bundle(folder / "bundle", student, bundle_spec(robot, teacher, design, {}))
    print(best.sentence(), deploy.run(folder / "bundle", (0.5, 0.0, 0.0), 10.0, log=folder / "rollout.mcap"), sep="\n")


if __name__ == "__main__":
    tyro.cli(main)
