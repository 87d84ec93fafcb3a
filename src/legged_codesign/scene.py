"""The ground of a task as a scene for one robot, which starts at the world's origin."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

import mujoco
import numpy as np
from locorl import TaskConfig, flat_scene
from locorl.terrain.map import TerrainMap

_RGB = mujoco.mjtTextureRole.mjTEXROLE_RGB


def training_scene(task: TaskConfig) -> mujoco.MjSpec:
    """The ground that robots train `task` on, ready to attach a robot to.

    It lies so that the start of the first kind of terrain, on the level that training begins with, is at the origin,
    and the way leads along x: a robot in its stance there stands as it did in training.
    """
    scene, ground = flat_scene(task.physics), TerrainMap(task.terrain)
    ground.add_to(scene)
    level = min(task.curriculum.start_level, len(ground.difficulty) - 1)
    start = ground.origins[level, 0].double().numpy()
    for geom in scene.worldbody.geoms:
        geom.pos = np.asarray(geom.pos) - start
    _paint_plainly(scene)
    return scene


def _paint_plainly(scene: mujoco.MjSpec) -> None:
    """A height field's colours by height are a texture in memory, which no MJCF file can hold: one colour instead."""
    ground = scene.material("terrain")
    if ground is not None:
        ground.textures[_RGB], ground.rgba = "", [0.84, 0.84, 0.83, 1.0]
        scene.delete(scene.texture("terrain"))
