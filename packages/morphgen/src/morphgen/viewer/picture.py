"""What the viewer shows of a design: solids in their places, measurements and verdicts; knows no browser."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo ships no type stubs
from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from morphgen.factory import BodyFactory
from morphgen.stance.solve import KNEE_CLEARANCE
from morphgen.urdf.tree import Inertial, read_tree
from morphgen.views.dimensions import dimensions

Array = NDArray[np.float64]

_MM = 1000.0
_BOX, _SPHERE, _CYLINDER, _CAPSULE, _MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")) for kind in ("BOX", "SPHERE", "CYLINDER", "CAPSULE", "MESH")
)


@dataclass(frozen=True)
class Solid:
    """A coloured surface in the world.

    Attributes:
        name: unique within a body, the same for every design.
        vertices: (v, 3) in its own frame, before the scale.
        faces: (f, 3) indices of vertices, counter-clockwise seen from outside.
        round: whether its edges are to be shaded away.
        scale: (3,) factors along its own axes.
        position: (3,) [m], z up from the floor.
        wxyz: (4,) unit quaternion.
        color: (3,) red, green and blue in [0, 1].
    """

    name: str
    vertices: Array
    faces: NDArray[np.int64]
    round: bool
    scale: Array
    position: Array
    wxyz: Array
    color: Array


@dataclass(frozen=True)
class Picture:
    """One design as it is shown.

    Attributes:
        design: (d,) values of the design parameters.
        solids: the robot in its stance, forward along x, the base above the origin.
        dimensions: measurements by name, the unit ending each name; see `views.dimensions`.
        links: number of links that have a mass.
        invalid_links: those whose inertia no rigid body has, with the reason.
        problems: why the stance is not sound; empty when the body is feasible.
    """

    design: Array
    solids: tuple[Solid, ...]
    dimensions: dict[str, float]
    links: int
    invalid_links: dict[str, str]
    problems: tuple[str, ...]

    @property
    def size(self) -> float:
        """Largest distance of a solid's centre from the point below the base [m]."""
        return float(max(np.linalg.norm(solid.position) for solid in self.solids))

    @property
    def feasible(self) -> bool:
        """Whether the stance is sound."""
        return not self.problems


def picture(factory: BodyFactory, design: ArrayLike) -> Picture:
    """Everything the viewer shows of one design (d,).

    Raises:
        MorphologyError: the design is out of bounds, or no model can be made of it.
    """
    checked = factory.space.validated(design)[0]
    model = factory.spec(checked).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = factory.batch(checked).stance_qpos[0]
    mujoco.mj_kinematics(model, data)
    inertials = {link.name: link.inertial for link in read_tree(factory.urdf(checked), factory.name).links}
    problems = {name: inertia_problem(inertial) for name, inertial in inertials.items() if inertial is not None}
    return Picture(
        design=checked,
        solids=_solids(model, data),
        dimensions=dimensions(factory, checked),
        links=len(problems),
        invalid_links={name: problem for name, problem in problems.items() if problem is not None},
        problems=_stance_problems(factory, checked, model, data),
    )


def inertia_problem(inertial: Inertial) -> str | None:
    """Why no rigid body has this mass and inertia; None where one has."""
    low, middle, high = np.linalg.eigvalsh(inertial.inertia)
    if inertial.mass <= 0:
        return f"mass {inertial.mass:g} kg is not positive"
    if low <= 0:
        return f"principal moment {low:.3g} kg m² is not positive"
    if low + middle < high * (1 - 1e-9):
        return f"principal moments {low:.3g} + {middle:.3g} < {high:.3g} kg m²"
    return None


def _stance_problems(
    factory: BodyFactory, design: Array, model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[str, ...]:
    stance, body = factory.stance(design[None]), factory.skeleton(design[None])
    if stance.feasible[0]:
        return ()
    problems = []
    for foot, radius in zip(factory.layout.feet, np.ravel(body.foot_radius), strict=True):
        gap = data.site(foot).xpos[2] - radius
        if gap > 1e-3:
            problems.append(f"{foot} hangs {gap * _MM:.0f} mm above the floor")
    for name in factory.layout.joints[2::3]:
        height = data.xanchor[model.joint(name).id, 2]
        if height < KNEE_CLEARANCE:
            problems.append(f"{name} is at {height * _MM:.0f} mm, not {KNEE_CLEARANCE * _MM:.0f} mm above the floor")
    for what, value, low, high in (
        ("limit", stance.joints[0], body.lower, body.upper),
        ("torque limit", stance.torque[0], -body.effort, body.effort),
    ):
        stopped = ((value <= low) | (value >= high)).ravel()
        problems += [f"{name} is at its {what}" for name, at in zip(factory.layout.joints, stopped, strict=True) if at]
    return tuple(problems) or ("no level stance with the feet on the floor",)


def _solids(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Solid, ...]:
    solids = []
    for geom in np.flatnonzero(model.geom_bodyid):
        surface = _surface(model, geom)
        if surface is None:
            continue
        wxyz = np.empty(4)
        mujoco.mju_mat2Quat(wxyz, data.geom_xmat[geom])
        mesh, scale, is_round = surface
        solids.append(
            Solid(
                name=model.geom(geom).name or f"geom{geom}",
                vertices=np.asarray(mesh.vertices),
                faces=np.asarray(mesh.faces),
                round=is_round,
                scale=np.asarray(scale, dtype=np.float64),
                position=data.geom_xpos[geom].copy(),
                wxyz=wxyz,
                color=model.geom_rgba[geom, :3].astype(np.float64),
            )
        )
    return tuple(solids)


def _surface(model: mujoco.MjModel, geom: int) -> tuple[trimesh.Trimesh, ArrayLike, bool] | None:
    """Mesh, scale and roundness of a geom in its own frame; None for a kind that robots have not."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _BOX:
        return _unit_box(), 2 * size, False
    if kind == _SPHERE:
        return _unit_sphere(), np.repeat(size[0], 3), True
    if kind == _CYLINDER:
        return _unit_cylinder(), (size[0], size[0], 2 * size[1]), False
    if kind == _CAPSULE:
        return trimesh.creation.capsule(height=2 * size[1], radius=size[0], count=[24, 24]), (1, 1, 1), True
    if kind == _MESH:
        mesh = model.mesh(model.geom_dataid[geom])
        vertices = model.mesh_vert[mesh.vertadr[0] :][: mesh.vertnum[0]]
        faces = model.mesh_face[mesh.faceadr[0] :][: mesh.facenum[0]]
        return trimesh.Trimesh(vertices, faces, process=False), (1, 1, 1), False
    return None


@cache
def _unit_box() -> trimesh.Trimesh:
    return trimesh.creation.box(extents=(1, 1, 1))


@cache
def _unit_sphere() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=1)


@cache
def _unit_cylinder() -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=1, height=1, sections=48)
