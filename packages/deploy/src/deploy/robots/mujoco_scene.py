"""The scene of a bundle as MuJoCo reads it: compiled, found to hold the robot of the manifest, and addressed."""

# pyright: reportAttributeAccessIssue=false
# mujoco ships no type stubs for its compiled modules.
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
from numpy.typing import NDArray

from deploy.bundles.manifest import Bundle
from deploy.errors import RobotError

SAME_BODY = 1e-3
"""Relative difference of mass or torque limit below which model and manifest mean the same body; MJCF keeps
about six digits."""


@dataclass(frozen=True)
class JointAddresses:
    """Where the joints of the robot live in the model, in the order of its actuators, shape (12,) each."""

    names: tuple[str, ...]
    actuator: NDArray[np.intp]
    qpos: NDArray[np.intp]
    dof: NDArray[np.intp]


@dataclass(frozen=True)
class Scene:
    """A compiled scene and where its robot is in it.

    Attributes:
        model: The model; owned by whoever loaded it.
        joints: Where the joints are.
        base: Body of the base.
        root_qpos: First position of its free joint.
        root_dof: First velocity of its free joint.
        foot_sites: In the order of the manifest.
        foot_geoms: What touches the ground there, shape (4,).
    """

    model: mujoco.MjModel
    joints: JointAddresses
    base: int
    root_qpos: int
    root_dof: int
    foot_sites: list[int]
    foot_geoms: NDArray[np.intp]


def load_scene(bundle: Bundle) -> Scene:
    """Compile the scene of a bundle.

    Raises:
        RobotError: The scene does not compile, reads files outside of the bundle, or does not hold the robot that the
            manifest describes.
    """
    path = bundle.path(bundle.robot.scene)
    _stay_inside(path)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise RobotError(f"{path}: MuJoCo cannot compile it ({error}); export it again") from error
    # A diverged simulation must reach the guards as it is, not restart behind their back.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    finder = _Finder(path, model)
    joints = finder.joints(bundle)
    base = finder.find("body", mujoco.mjtObj.mjOBJ_BODY, bundle.robot.base)
    feet = [finder.find("site", mujoco.mjtObj.mjOBJ_SITE, foot) for foot in bundle.robot.feet]
    finder.check_body(bundle, joints, base)
    root_qpos, root_dof = finder.root(bundle.robot.base, base)
    return Scene(model, joints, base, root_qpos, root_dof, feet, np.array([finder.foot_geom(foot) for foot in feet]))


def _stay_inside(path: Path) -> None:
    """Refuse references to files that no hash of the bundle covers."""
    try:
        elements = list(ElementTree.parse(path).iter())
    except ElementTree.ParseError as error:
        raise RobotError(f"{path}: not valid XML ({error}); export it again") from error
    for element in elements:
        for name, value in element.attrib.items():
            if name in ("meshdir", "texturedir", "assetdir") or (name.startswith("file") and Path(value).name != value):
                raise RobotError(
                    f"{path}: <{element.tag} {name}={value!r}> reaches outside of the bundle; put the file beside it "
                    "and list it in the manifest"
                )


@dataclass(frozen=True)
class _Finder:
    """Looks things up in a model, and says what is not there."""

    path: Path
    model: mujoco.MjModel

    def find(self, kind: str, object_type: int, name: str) -> int:
        index = mujoco.mj_name2id(self.model, object_type, name)
        if index < 0:
            raise RobotError(f"{self.path}: no {kind} {name!r} in it; export the bundle again")
        return index

    def joints(self, bundle: Bundle) -> JointAddresses:
        model = self.model
        wanted = {
            self.find("actuator", mujoco.mjtObj.mjOBJ_ACTUATOR, joint.actuator): joint.name for joint in bundle.joints
        }
        if model.nu != len(wanted):
            raise RobotError(f"{self.path}: {model.nu} actuators, the manifest has {len(wanted)}; export it again")
        qpos, dof = [], []
        for actuator, name in sorted(wanted.items()):
            joint = self.find("joint", mujoco.mjtObj.mjOBJ_JOINT, name)
            servo = (
                model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
                and model.actuator_trnid[actuator, 0] == joint
                and model.actuator_gear[actuator, 0] == 1.0
                and model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
                and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
                and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
            )
            if not servo:
                raise RobotError(
                    f"{self.path}: actuator of {name} is not a position servo on that joint; "
                    "use <position joint=... kp=... kv=...> with gear 1"
                )
            qpos.append(model.jnt_qposadr[joint])
            dof.append(model.jnt_dofadr[joint])
        return JointAddresses(
            names=tuple(wanted[actuator] for actuator in sorted(wanted)),
            actuator=np.array(sorted(wanted)),
            qpos=np.array(qpos),
            dof=np.array(dof),
        )

    def root(self, name: str, base: int) -> tuple[int, int]:
        joint = self.model.body_jntadr[base]
        if joint < 0 or self.model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
            raise RobotError(f"{self.path}: body {name!r} has no free joint; export the bundle again")
        return int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])

    def foot_geom(self, site: int) -> int:
        """The geom of a foot: of those of its body that can touch, the one nearest to its site."""
        model = self.model
        can_touch = (model.geom_contype | model.geom_conaffinity) > 0
        geoms = np.flatnonzero((model.geom_bodyid == model.site_bodyid[site]) & can_touch)
        if not len(geoms):
            raise RobotError(f"{self.path}: foot {model.site(site).name!r} has no geom that can touch the ground")
        gaps = np.linalg.norm(model.geom_pos[geoms] - model.site_pos[site], axis=1)
        return int(geoms[np.argmin(gaps)])

    def check_body(self, bundle: Bundle, joints: JointAddresses, base: int) -> None:
        model = self.model
        limits = {joint.name: joint.torque_limit for joint in bundle.joints}
        pairs = {"total mass": (model.body_subtreemass[base], bundle.robot.total_mass)}
        for actuator, name in zip(joints.actuator, joints.names, strict=True):
            joint = model.actuator_trnid[actuator, 0]
            found = [np.inf]
            if model.actuator_forcelimited[actuator]:
                found.append(model.actuator_forcerange[actuator, 1])
            if model.jnt_actfrclimited[joint]:
                found.append(model.jnt_actfrcrange[joint, 1])
            pairs[f"torque limit of {name}"] = (min(found), limits[name])
        pairs["physics step"] = (model.opt.timestep, bundle.physics_dt)
        for what, (in_model, in_manifest) in pairs.items():
            if not np.isclose(in_model, in_manifest, rtol=SAME_BODY, atol=0.0):
                raise RobotError(
                    f"{self.path}: {what} is {in_model:g}, the manifest says {in_manifest:g}; "
                    "the scene holds another body: export the bundle again"
                )
