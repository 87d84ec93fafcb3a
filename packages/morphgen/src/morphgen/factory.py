"""From design vectors to bodies: the class that simulators and searches hold."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from morphgen.errors import MorphologyError, naming
from morphgen.prepare import prepare
from morphgen.scaling.articulate import Collisions, articulate
from morphgen.scaling.bodies import Bodies, Rule, nominal_bodies, scale_bodies
from morphgen.scaling.design import DesignSpace
from morphgen.simulation.batch import BodyBatch
from morphgen.simulation.drive import Drive
from morphgen.simulation.fields import gain_fields, model_fields
from morphgen.simulation.layout import make_layout
from morphgen.simulation.model import build_spec
from morphgen.skeleton import Array, Skeleton
from morphgen.stance.gains import GainRule, gain_factors
from morphgen.stance.kinematics import forward_kinematics
from morphgen.stance.problems import stance_problems
from morphgen.stance.stability import LEAST_BUCKLING_FACTOR, buckling_factor
from morphgen.stance.stance import Stance, solve_stance
from morphgen.urdf.meshes import MeshFinder, baked
from morphgen.urdf.tree import Shape
from morphgen.urdf.writer import ScaledUrdf, oblique_visuals, write_urdf

_TURN = 2 * np.pi


@dataclass(frozen=True)
class _Made:
    """N bodies with their stances and gains, kp and kd (n, 12)."""

    skeleton: Skeleton
    collisions: Collisions
    stance: Stance
    kp: Array
    kd: Array


class BodyFactory:
    """Makes bodies of one robot from design vectors.

    Attributes:
        name: the robot.
        space: its design parameters and their bounds.
        rule: how thigh and shank scale, see `morphgen.scaling.bodies.Rule`.
        gains: how the PD gains follow the body.
        layout: names and order of joints, feet, links and sensors.
        drive: servo at every joint.
        robot: the nominal robot as read, with its collisions as primitives.
        source: file or name of the URDF, for messages.
        notes: what had to be repaired or replaced in the file.
        meshes: finds the mesh files of the robot.
        folder: of the URDF; None for a robot that came as text.
    """

    def __init__(
        self,
        name: str,
        urdf: str,
        *,
        space: DesignSpace | None = None,
        rule: Rule = "paper",
        gains: GainRule | None = None,
        drive: Drive | None = None,
        source: str | Path | None = None,
        mesh_paths: Sequence[Path] = (),
        repair: bool = False,
        lock: Collection[str] = (),
        hips: Mapping[str, str] | None = None,
    ) -> None:
        """Read the robot.

        Args:
            name: the robot.
            urdf: text of its URDF.
            space: None for the four leg scales in [0.6, 1.4].
            rule: `paper` needs box thighs and shanks; `stretch` and `lumped` take any quadruped.
            gains: None for constant gains.
            drive: None for a servo sized to the robot's weight and height.
            source: file of the URDF, for messages and for its meshes.
            mesh_paths: folders in which meshes are looked for.
            repair: whether impossible inertias are repaired (see `notes`) instead of refused.
            lock: joints that are fixed at zero, such as those of an arm.
            hips: hip joint of each of FL, FR, RL, RR, where the legs are not found by their place.

        Raises:
            MorphologyError: the URDF is not a quadruped that the rule can scale.
        """
        self.name = name
        self.space = DesignSpace.leg_scales() if space is None else space
        self.rule: Rule = rule
        if rule != "lumped" and "motor_placement" in self.space.names:
            raise MorphologyError(f"motor_placement moves the motor of rule 'lumped'; rule '{rule}' has none")
        self.gains = GainRule() if gains is None else gains
        self.folder = source.parent if isinstance(source, Path) else None
        self.meshes = MeshFinder(source if isinstance(source, Path) else None, mesh_paths)
        self.source = str(source or name)
        with naming(self.source):
            self._read(urdf, repair, lock, hips)
        if drive is None:
            drive = Drive.sized(float(self._nominal.total_mass[0]), float(self._nominal_stance.hip_height[0]))
        self.drive = drive
        self.layout = make_layout(name, self.robot.tree, self.robot.leg_map, self._nominal)

    @property
    def rules(self) -> Mapping[str, str]:
        """What bodies follow from besides their designs, by name: the rules of scaling and of gains."""
        coefficients = self.gains.coefficients
        gains = f"{self.gains.kind} {coefficients}" if coefficients else self.gains.kind
        return {"scaling": self.rule, "gains": gains}

    def _read(self, urdf: str, repair: bool, lock: Collection[str], hips: Mapping[str, str] | None) -> None:
        self.robot, self.notes = prepare(urdf, self.source, self.meshes, repair=repair, lock=lock, hips=hips)
        self._links = nominal_bodies(self.robot.tree)
        # all rules meet their demands on the robot here, not when the first body is made
        self._nominal, self._collisions = articulate(self.robot, self._bodies(self.space.nominal[None]))
        self._nominal_stance = solve_stance(self._nominal, collisions=self._collisions)

    def urdf(self, design: ArrayLike) -> str:
        """The scaled URDF of one design (d,); relative mesh paths are as in the source, see `scaled_urdf`."""
        return self._scaled(design, bake=False).text

    def scaled_urdf(self, design: ArrayLike) -> ScaledUrdf:
        """The scaled URDF of one design (d,), with the meshes that had to be made for it.

        Raises:
            MorphologyError: such a mesh is missing; names file, link and remedy.
        """
        return self._scaled(design, bake=True)

    def check_urdfs(self, designs: ArrayLike) -> None:
        """Read the meshes that `scaled_urdf` needs for any of the designs (n, d), so that it will not fail later.

        The two corners of a box, all lower and all upper bounds, stand for all designs within it.

        Raises:
            MorphologyError: a mesh is missing or cannot be read; names file, link and remedy.
        """
        morphology = self.space.morphology(self.space.validated(designs))
        with naming(self.source):
            for g, _, _ in oblique_visuals(self.robot, morphology):
                self._visual(self.robot.tree.shapes[g])

    def spec(self, design: ArrayLike, scene: mujoco.MjSpec | None = None) -> mujoco.MjSpec:
        """A fresh MuJoCo spec of one design (d,)."""
        self._check_motors()
        made = self._make(self._one(design))
        return build_spec(made.skeleton, made.collisions, self.layout, self.drive, made.kp[0], made.kd[0], scene)

    def batch(self, designs: ArrayLike, scene: mujoco.MjSpec | None = None) -> BodyBatch:
        """Bodies for designs (n, d) as fields of one model, without a file or a compilation per body.

        Args:
            designs: (n, d) float, each within the space.
            scene: the world to put the robot into, copied; None for a flat floor with a 5 ms time step.

        Raises:
            MorphologyError: a design out of bounds; names row and parameter. Or a motor without a torque limit.
        """
        self._check_motors()
        checked = self.space.validated(designs)
        different, index = np.unique(checked, axis=0, return_inverse=True)
        if len(different) < len(checked):
            return self.batch(different, scene).take(index.ravel())
        made = self._make(checked)
        model = self.spec(self.space.nominal, scene).compile()
        nominal = (self._nominal, self._collisions)
        fields = model_fields(model, nominal, made.skeleton, made.collisions, self.layout)
        if self.gains.kind != "none":
            fields |= gain_fields(model, self.layout, made.kp, made.kd)
        return self._assemble(checked, model, fields, made)

    def skeleton(self, designs: ArrayLike) -> Skeleton:
        """Geometry, mass and limits of the designs (n, d) as arrays."""
        return articulate(self.robot, self._bodies(self.space.validated(designs)))[0]

    def collisions(self, designs: ArrayLike) -> Collisions:
        """Collision primitives of the designs (n, d)."""
        return articulate(self.robot, self._bodies(self.space.validated(designs)))[1]

    def stance(self, designs: ArrayLike) -> Stance:
        """Stances of the designs (n, d)."""
        return self._make(self.space.validated(designs)).stance

    def feasible(self, designs: ArrayLike) -> NDArray[np.bool_]:
        """Whether each design (n, d) has a sound level stance, (n,)."""
        return self.stance(designs).feasible

    def problems(self, design: ArrayLike) -> tuple[str, ...]:
        """Why one design (d,) is not feasible, a phrase each; () if it is."""
        made = self._make(self._one(design))
        return stance_problems(made.skeleton, made.collisions, made.stance, made.kp, self.layout)

    def sample(self, n: int, rng: np.random.Generator) -> Array:
        """N feasible designs, uniform in the space, (n, d).

        Raises:
            MorphologyError: hardly any design of the space is feasible.
        """
        kept, tried, size = np.zeros((0, self.space.dim)), 0, 64
        while len(kept) < n:
            drawn = self.space.sample(size, rng)
            kept = np.vstack([kept, drawn[self.feasible(drawn)]])
            tried, size = tried + size, min(2 * size, 4096)
            if 100 * len(kept) < tried - 200:
                raise MorphologyError(
                    f"{self.name}: only {len(kept)} of {tried} designs of the space have a sound level stance; "
                    "narrow its bounds"
                )
        return kept[:n]

    def _bodies(self, designs: Array, *, visuals: bool = False) -> Bodies:
        return scale_bodies(self.robot, self.space.morphology(designs), self.rule, visuals=visuals)

    def _check_motors(self) -> None:
        with naming(self.source):
            self.drive.torque_limits(self._nominal, self.layout)

    def _make(self, designs: Array) -> _Made:
        skeleton, collisions = articulate(self.robot, self._bodies(designs))
        stance = solve_stance(skeleton, collisions=collisions)
        nominal = (self._nominal, self._nominal_stance, designs, self.space.nominal)
        eta = gain_factors(self.gains, skeleton, stance, *nominal)
        stiffness = self.drive.kp * eta
        poses = forward_kinematics(skeleton, stance.joints)
        stable = buckling_factor(skeleton, poses, stiffness) >= LEAST_BUCKLING_FACTOR
        stance = replace(stance, feasible=stance.feasible & stable)
        damping = self.drive.kd * eta
        return _Made(skeleton, collisions, stance, stiffness.reshape(-1, 12), damping.reshape(-1, 12))

    def _scaled(self, design: ArrayLike, *, bake: bool) -> ScaledUrdf:
        designs = self._one(design)
        body = self._bodies(designs, visuals=True)
        morphology = self.space.morphology(designs)
        with naming(self.source):
            return write_urdf(self.robot, morphology, self._links, body, self._bake if bake else None)

    def _bake(self, shape: Shape, linear: Array) -> bytes:
        return baked(self._visual(shape), linear)

    def _visual(self, shape: Shape) -> trimesh.Trimesh:
        assert shape.mesh is not None
        return self.meshes.load(shape.mesh, f"link '{self.robot.tree.links[shape.link].name}' visual")

    def _assemble(
        self,
        designs: Array,
        model: mujoco.MjModel,
        fields: dict[str, Array],
        made: _Made,
    ) -> BodyBatch:
        n, bodies, stance = len(designs), made.skeleton, made.stance
        joints = stance.joints.reshape(n, 12)
        qpos = np.repeat(model.qpos0[None], n, axis=0)
        free = model.joint(f"{self.layout.base}_free").qposadr[0]
        qpos[:, free : free + 7] = (0, 0, 0, 1, 0, 0, 0)
        qpos[:, free + 2] = stance.base_height
        qpos[:, [model.joint(name).qposadr[0] for name in self.layout.joints]] = joints

        def shared(values: Array) -> Array:
            return np.tile(values.ravel(), (n, 1))

        return BodyBatch(
            designs=designs,
            model=model,
            fields=fields,
            stance_qpos=qpos,
            stance_ctrl=joints + stance.torque.reshape(n, 12) / made.kp,
            feasible=stance.feasible,
            kp=made.kp,
            kd=made.kd,
            torque_limit=shared(self.drive.torque_limits(bodies, self.layout)),
            velocity_limit=shared(self.drive.velocity_limits(bodies)),
            joint_lower=shared(np.maximum(bodies.lower, -_TURN)),
            joint_upper=shared(np.minimum(bodies.upper, _TURN)),
            total_mass=bodies.total_mass,
            hip_height=stance.hip_height,
        )

    def _one(self, design: ArrayLike) -> Array:
        checked = self.space.validated(design)
        if len(checked) != 1:
            raise MorphologyError(f"expected one design of {self.space.dim} values, got {len(checked)} designs")
        return checked


def scale_urdf(
    text: str,
    scales: ArrayLike,
    *,
    rule: Rule = "stretch",
    source: str = "URDF",
    mesh_paths: Sequence[Path] = (),
) -> str:
    """Scale the legs of a URDF, whatever the bounds of a design space; everything else in the file stays.

    Args:
        text: of the URDF.
        scales: (4,) scales of front thigh, front shank, hind thigh and hind shank.
        rule: how thigh and shank scale.
        source: name of the file, for messages.
        mesh_paths: folders in which collision meshes are looked for.

    Returns:
        The scaled URDF; its numbers read back to the same float64.

    Raises:
        MorphologyError: not a quadruped that the rule can scale, or bad scales.
    """
    values = np.asarray(scales, dtype=np.float64)
    if values.shape != (4,) or not np.all(np.isfinite(values) & (values > 0)):
        raise MorphologyError(f"leg scales must be 4 positive numbers, got {scales!r}")
    space = DesignSpace.leg_scales(min(1.0, float(values.min())), max(1.0, float(values.max())))
    return BodyFactory(source, text, space=space, rule=rule, source=source, mesh_paths=mesh_paths).urdf(values)
