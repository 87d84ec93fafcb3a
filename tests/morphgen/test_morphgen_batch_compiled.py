"""Every body of a batch against freshly compiled models: ours, and the exported URDF in plain MuJoCo."""

import mujoco
import mujoco.batch
import numpy as np
import pytest
import robot_defects as defects
from lxml import etree
from morphgen import BodyFactory, DesignSpace, Drive, GainRule, flat_scene, load_robot
from numpy.testing import assert_allclose
from plain_mujoco import ball_centre, compile_urdf, mass_matrix, pose, random_poses

ARMATURE, DAMPING, FRICTION = 0.01, 0.1, 0.1
"""Of all robots here; none is from a file that gives another."""


def vendors_robot() -> str:
    """What real files contain, all at once: no link's frame or shape lies along the leg."""
    robot = defects.clean()
    for change in ("lateral_knee", "rotated_boxes", "tilted_cylinders", "massless_links", "rotors", "asymmetric"):
        defects.ALL[change](robot, None)
    for ankle, _, y in defects.each(robot, "joint", "foot_joint"):
        ankle.find("origin").set("xyz", f"0.02 {-0.08 * y} -0.22")
    defects.oblique_frames(robot, None)
    return etree.tostring(robot, encoding="unicode")


def vendor(gains: GainRule) -> BodyFactory:
    space = DesignSpace.of(front_thigh=(0.7, 1.3), rl_shank=(0.8, 1.2), hip_offset=(0.7, 1.3), trunk_length=(0.8, 1.3))
    drive = Drive(60.0, 1.5, ARMATURE, DAMPING, FRICTION)
    return BodyFactory("vendor", vendors_robot(), rule="stretch", space=space, gains=gains, drive=drive)


def aligned_robot() -> str:
    """Frames that coincide as long as nothing is stretched: MuJoCo then takes one for the other."""
    robot = defects.clean()
    defects.oblique_foot(robot, None)
    for shank, _, _ in defects.each(robot, "link", "shank"):
        shank.remove(shank.find("inertial"))
        defects.add(shank, defects.inertial(0.19, (0.02, 0, -0.1), (1.27e-3, 1.25e-3, 3.6e-5)))
    for thigh, _, _ in defects.each(robot, "link", "thigh"):
        thigh.remove(thigh.find("inertial"))
        defects.add(thigh, defects.inertial(1.18, (0, 0, -0.1), (0.0062, 0.0061, 0.0011)))
        for tag in ("inertial", "collision"):
            thigh.find(f"{tag}/origin").set("rpy", "0 0.2 0")
    return etree.tostring(robot, encoding="unicode")


def aligned(gains: GainRule) -> BodyFactory:
    drive = Drive(60.0, 1.5, ARMATURE, DAMPING, FRICTION)
    return BodyFactory("aligned", aligned_robot(), rule="stretch", gains=gains, drive=drive)


ROBOTS = {
    "go2-paper": lambda gains: load_robot("go2", gains=gains),
    "go2-paper-wide": lambda gains: load_robot("go2", space=DesignSpace.wide(), gains=gains),
    "go2-stretch": lambda gains: load_robot("go2", rule="stretch", gains=gains),
    "lite3-lumped": lambda gains: load_robot("lite3", rule="lumped", gains=gains),
    "go2-stretch-wide": lambda gains: load_robot("go2", rule="stretch", space=DesignSpace.wide(), gains=gains),
    "lite3-stretch-per-leg": lambda gains: load_robot(
        "lite3", rule="stretch", space=DesignSpace.per_leg(0.8, 1.2), gains=gains
    ),
    "vendor": vendor,
    "aligned": aligned,
}
QUICK = {
    "go2-paper-stance",
    "go2-stretch-none",
    "lite3-lumped-stance",
    "go2-stretch-wide-stance",
    "vendor-stance",
    "aligned-none",
}
PAIRS = [
    pytest.param((name, gains), id=f"{name}-{gains}", marks=() if f"{name}-{gains}" in QUICK else pytest.mark.slow)
    for name in ROBOTS
    for gains in ("none", "stance")
]


@pytest.fixture(scope="module", params=PAIRS)
def robot(request) -> BodyFactory:
    name, gains = request.param
    return ROBOTS[name](GainRule(gains))


@pytest.fixture(scope="module")
def batch(robot):
    """The nominal body, all bounds at once, and three feasible ones, one of them twice."""
    space = robot.space
    feasible = robot.sample(3, np.random.default_rng(3))
    return robot.batch(np.vstack([space.nominal, space.low, space.high, feasible, feasible[:1]]))


def simulations(batch) -> mujoco.batch.Batch:
    sims = mujoco.batch.Batch(batch.model, batch.n, 1)
    for name, values in batch.fields.items():
        sims.expand(name)[:] = values
    sims.set_const()
    return sims


def lowered(qpos: np.ndarray) -> np.ndarray:
    """3 mm into the floor, so that the feet touch it."""
    return qpos - 0.003 * np.eye(19)[2]


def tensor(diagonal: np.ndarray, quats: np.ndarray) -> np.ndarray:
    """(b, 3, 3) inertias in body axes."""
    turns = np.zeros((len(quats), 9))
    for turn, quat in zip(turns, quats, strict=True):
        mujoco.mju_quat2Mat(turn, quat)
    turns = turns.reshape(-1, 3, 3)
    return turns @ (diagonal[:, :, None] * np.swapaxes(turns, 1, 2))


ARRAYS = [
    name
    for name, value in ((name, getattr(flat_scene().compile(), name)) for name in dir(mujoco.MjModel))
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu"
]


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    return {name: getattr(model, name) for name in ARRAYS}


def full_mass(model, data) -> np.ndarray:
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


FRAMES = {"body_inertia", "body_iquat", "body_sameframe", "geom_sameframe", "geom_quat", "bvh_aabb", "bvh_nodeid"}
"""Fields that may name the same body in other words: principal axes in another order, q and -q,
another tree of bounding volumes."""


def test_no_field_differs_from_a_fresh_compilation(robot, batch):
    sims = simulations(batch)
    for i, design in enumerate(batch.designs):
        mine, fresh = sims.get_model(i), robot.spec(design).compile()
        expected = arrays(fresh)
        for name, values in arrays(mine).items():
            if name not in FRAMES:
                assert_allclose(values, expected[name], rtol=1e-9, atol=1e-12, err_msg=name)
        assert_allclose(
            tensor(mine.body_inertia, mine.body_iquat), tensor(fresh.body_inertia, fresh.body_iquat), atol=1e-12
        )
        one = np.ones((mine.ngeom, 3)) * (1, 2, 3)
        assert_allclose(tensor(one, mine.geom_quat), tensor(one, fresh.geom_quat), atol=1e-9)


def test_derived_fields_are_those_of_a_fresh_compilation(robot, batch):
    derived = batch.derived(1)
    assert {"body_invweight0", "dof_invweight0", "geom_rbound", "geom_aabb", "body_subtreemass"} <= derived.keys()
    for i, design in enumerate(batch.designs):
        fresh = robot.spec(design).compile()
        for name, values in derived.items():
            assert_allclose(values[i], getattr(fresh, name), rtol=1e-9, atol=1e-12, err_msg=name)


def test_bodies_move_as_those_of_a_fresh_compilation(robot, batch):
    sims = simulations(batch)
    for i, design in enumerate(batch.designs):
        models = sims.get_model(i), robot.spec(design).compile()
        data = [mujoco.MjData(model) for model in models]
        rng = np.random.default_rng(i)
        qpos, qvel = lowered(batch.stance_qpos[i]), rng.normal(size=18)
        qpos[7:] += rng.uniform(-0.1, 0.1, 12)
        for model, state in zip(models, data, strict=True):
            state.qpos[:], state.qvel[:], state.ctrl[:] = qpos, qvel, batch.stance_ctrl[i]
            mujoco.mj_forward(model, state)
        mine, fresh = data
        assert_allclose(full_mass(models[0], mine), full_mass(models[1], fresh), rtol=1e-9, atol=1e-11)
        for field in ("xpos", "xquat", "xipos", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat", "qfrc_bias"):
            ours, theirs = getattr(mine, field), getattr(fresh, field)
            if field == "geom_xmat":  # a cylinder's frame may be turned about its axis by rounding alone
                ours, theirs = ours[:, [2, 5, 8]], theirs[:, [2, 5, 8]]
            assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9, err_msg=field)
        assert mine.ncon == fresh.ncon
        assert_allclose(mine.contact.dist, fresh.contact.dist, atol=1e-9)
        assert_allclose(mine.contact.pos, fresh.contact.pos, atol=1e-9)


def trajectory(model: mujoco.MjModel, qpos, ctrl) -> np.ndarray:
    """Positions after 100 steps, which end in contact."""
    data = mujoco.MjData(model)
    data.qpos[:], data.ctrl[:] = qpos, ctrl
    mujoco.mj_step(model, data, 100)
    assert data.ncon >= 1
    return data.qpos.copy()


def test_a_hundred_steps_with_contacts_are_those_of_a_fresh_compilation(robot, batch):
    sims = simulations(batch)
    sims.bind("qpos")[:] = start = np.array([lowered(qpos) for qpos in batch.stance_qpos])
    sims.bind("ctrl")[:] = batch.stance_ctrl
    sims.step(nstep=100)
    exact = 0
    for i, design in enumerate(batch.designs):
        fresh = robot.spec(design).compile()
        final = trajectory(fresh, start[i], batch.stance_ctrl[i])
        assert_allclose(sims.bind("qpos")[i], final, rtol=0, atol=1e-6)
        mine, theirs = arrays(sims.get_model(i)), arrays(fresh)
        if all(np.array_equal(mine[name], theirs[name]) for name in mine):
            assert np.array_equal(sims.bind("qpos")[i], final)
            exact += 1
    if robot.name != "vendor":  # whose turned frames are rounded
        assert exact >= (batch.n if robot.rule == "paper" and robot.space.dim == 4 else 1)
    assert np.array_equal(sims.bind("qpos")[3], sims.bind("qpos")[-1])  # the same design


def exported(robot: BodyFactory, design, kp: np.ndarray, kd: np.ndarray) -> mujoco.MjModel:
    """The exported URDF on a floor with servos, put together by MuJoCo's own means alone."""
    spec = mujoco.MjSpec.from_string(robot.urdf(design))
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    spec.compiler.fusestatic = False
    spec.worldbody.first_body().add_freejoint()
    for geom in spec.geoms:
        geom.contype, geom.conaffinity = 1, 0
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], contype=0, conaffinity=1)
    for name, stiffness, rate in zip(robot.layout.joints, kp, kd, strict=True):
        joint = spec.joint(name)
        joint.armature, joint.frictionloss = ARMATURE, FRICTION
        joint.damping[0] = DAMPING
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = stiffness, -stiffness, -rate
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        limit = joint.actfrcrange[1]  # of the <limit effort>
        servo.forcelimited, servo.forcerange = mujoco.mjtLimited.mjLIMITED_TRUE, [-limit, limit]
    spec.option.timestep = 0.005
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    return spec.compile()


def order(robot: BodyFactory, model: mujoco.MjModel) -> list[int]:
    return [int(model.joint(name).qposadr[0]) for name in robot.layout.joints]


def test_bodies_are_those_of_their_exported_urdf(robot, batch):
    sims = simulations(batch)
    joints = robot.layout.joints
    for i, design in enumerate(batch.designs):
        mine, plain = sims.get_model(i), compile_urdf(robot.urdf(design))
        for base, angles in random_poses(2, i):
            data, other = pose(mine, base, joints, angles), pose(plain, base, joints, angles)
            assert_allclose(mass_matrix(plain, other, joints), mass_matrix(mine, data, joints), atol=1e-9)
            for link in robot.layout.links:
                assert_allclose(other.body(link).xpos, data.body(link).xpos, atol=1e-9)
            for foot in robot.layout.feet:
                assert_allclose(ball_centre(plain, other, foot), data.site(foot).xpos, atol=1e-9)


def test_bodies_touch_the_floor_and_move_as_their_exported_urdf(robot, batch):
    sims = simulations(batch)
    for i, design in enumerate(batch.designs):
        mine, plain = sims.get_model(i), exported(robot, design, batch.kp[i], batch.kd[i])
        qpos = lowered(batch.stance_qpos[i])
        same = qpos.copy()
        same[order(robot, plain)] = qpos[7:]
        data = [mujoco.MjData(model) for model in (mine, plain)]
        for model, state, start in zip((mine, plain), data, (qpos, same), strict=True):
            state.qpos[:] = start
            mujoco.mj_forward(model, state)
        assert data[0].ncon == data[1].ncon >= 1
        assert_allclose(np.sort(data[0].contact.dist), np.sort(data[1].contact.dist), atol=1e-9)
        if not batch.feasible[i]:  # it falls, and differences grow
            continue
        assert data[1].contact.dist.min() == pytest.approx(-0.003, abs=1e-9)
        ours = trajectory(mine, qpos, batch.stance_ctrl[i])
        ctrl = batch.stance_ctrl[i]
        controls = np.empty(12)
        controls[[plain.actuator(name).id for name in robot.layout.actuators]] = ctrl
        theirs = trajectory(plain, same, controls)
        assert_allclose(theirs[:7], ours[:7], rtol=0, atol=1e-6)
        assert_allclose(theirs[order(robot, plain)], ours[7:], rtol=0, atol=1e-6)


def test_one_design_repeated_is_what_it_is_among_others(robot, batch):
    """Shortcuts for aligned frames are set for a model as a whole."""
    row = 3
    alone = robot.batch(np.repeat(batch.designs[row : row + 1], 3, axis=0))
    results = []
    for bodies, rows in ((batch, [row]), (alone, [0, 1, 2])):
        sims = simulations(bodies)
        sims.bind("qpos")[:] = [lowered(qpos) for qpos in bodies.stance_qpos]
        sims.bind("ctrl")[:] = bodies.stance_ctrl
        sims.step(nstep=50)
        results += [sims.bind("qpos")[i].copy() for i in rows]
    for other in results[1:]:
        assert_allclose(other, results[0], rtol=0, atol=1e-9)


def test_gains_reach_the_torque(robot, batch):
    """eta = 1, or mass over nominal mass times leg length over nominal leg length, both measured in the models;
    lengths across the hinges, which are along y."""
    sims = simulations(batch)
    measured = []
    for i in range(batch.n):
        model = sims.get_model(i)
        legs = [
            sum(np.hypot(*model.body(robot.layout.body(leg, part)).pos[[0, 2]]) for part in (2, 3)) for leg in range(4)
        ]
        measured.append(model.body_mass.sum() * np.mean(legs))
    for i in range(batch.n):
        model = sims.get_model(i)
        eta = 1.0 if robot.gains.kind == "none" else measured[i] / measured[0]
        data = mujoco.MjData(model)
        rng = np.random.default_rng(i)
        error, rate = rng.uniform(-0.05, 0.05, 12), rng.uniform(-0.5, 0.5, 12)
        data.qpos[:] = batch.stance_qpos[i]
        data.qvel[6:], data.ctrl[:] = rate, data.qpos[7:] + error
        mujoco.mj_forward(model, data)
        kp, kd = robot.drive.kp, robot.drive.kd
        assert_allclose(data.actuator_force, eta * (kp * error - kd * rate), rtol=1e-9, atol=1e-12)
        assert_allclose(batch.kp[i], eta * kp, rtol=1e-9)
        assert_allclose(batch.kd[i], eta * kd, rtol=1e-9)


def test_the_aligned_robot_has_frames_that_coincide_until_it_is_stretched():
    same = mujoco.mjtSameFrame
    robot = aligned(GainRule())
    nominal, other = (robot.spec(design).compile() for design in (np.ones(4), np.full(4, 1.3)))
    thigh, shank = (nominal.body(f"FL_{part}").id for part in ("thigh", "shank"))
    box = int(nominal.body_geomadr[thigh])
    assert nominal.geom_sameframe[box] == same.mjSAMEFRAME_INERTIA
    assert nominal.body_sameframe[shank] == same.mjSAMEFRAME_BODYROT
    assert other.geom_sameframe[box] == other.body_sameframe[shank] == same.mjSAMEFRAME_NONE


def rough_scene() -> mujoco.MjSpec:
    """A height field, and a body of three boxes, so that MuJoCo's bounding volumes are in use."""
    scene = mujoco.MjSpec()
    scene.option.timestep = 0.002
    scene.option.gravity = [0.1, 0, -9.5]
    scene.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    scene.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    heights = np.random.default_rng(0).uniform(0, 1, (20, 20))
    scene.add_hfield(name="hills", nrow=20, ncol=20, size=[2, 2, 0.02, 0.1], userdata=heights.ravel())
    scene.worldbody.add_geom(name="hills", type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="hills", friction=[0.7, 0, 0])
    steps = scene.worldbody.add_body(name="steps", pos=[0, 0, 0.01])
    for i in range(3):
        steps.add_geom(
            name=f"step{i}", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 1, 0.01 * (i + 1)], pos=[0.2 * i - 0.2, 0, 0]
        )
    return scene


@pytest.mark.parametrize("name", ["go2-paper", "lite3-lumped", "vendor"])
def test_bodies_meet_a_rough_scene_as_freshly_compiled_ones(name):
    robot = ROBOTS[name](GainRule())
    scene = rough_scene()
    batch = robot.batch(robot.sample(4, np.random.default_rng(5)), scene)
    sims = simulations(batch)
    touched = differing = 0
    for i, design in enumerate(batch.designs):
        mine, fresh = sims.get_model(i), robot.spec(design, scene).compile()
        rng = np.random.default_rng(i)
        for height in (0.0, 0.06, 0.2):
            data = [mujoco.MjData(model) for model in (mine, fresh)]
            quat = rng.normal(size=4) * 0.1 + (1, 0, 0, 0)
            for model, state in zip((mine, fresh), data, strict=True):
                state.qpos[:] = batch.stance_qpos[i]
                state.qpos[2] -= height
                state.qpos[3:7] = quat / np.linalg.norm(quat)
                mujoco.mj_forward(model, state)
            assert_allclose(data[0].geom_xpos, data[1].geom_xpos, atol=1e-12)
            assert_allclose(data[0].geom_xmat, data[1].geom_xmat, atol=1e-12)
            mine_deep, fresh_deep = (np.array(each.contact.dist) for each in data)
            # how deep a mesh lies in a height field can hang on the last bit: one contact in a pose may differ
            same = np.isclose(mine_deep[:, None], fresh_deep, rtol=0, atol=1e-9)
            other = 1 if name == "vendor" else 0
            assert len(mine_deep) == len(fresh_deep)
            assert same.any(axis=1).sum() >= len(mine_deep) - other
            assert same.any(axis=0).sum() >= len(mine_deep) - other
            differing += int((~same.any(axis=1)).sum())
            touched += data[0].ncon
    assert touched > 20
    assert differing <= touched / 100


def test_the_scene_is_as_it_was_before_the_robot_came():
    robot = load_robot("go2", rule="stretch")
    for make in (flat_scene, rough_scene):
        scene = make()
        text = scene.to_xml()
        alone = make().compile()
        model = robot.batch(np.ones((2, 4)), scene).model
        assert scene.to_xml() == text
        for i in range(alone.ngeom):
            name = alone.geom(i).name
            ours, theirs = model.geom(name), alone.geom(name)
            for field in ("type", "size", "pos", "quat", "friction", "contype", "conaffinity", "solref", "margin"):
                assert np.array_equal(getattr(ours, field), getattr(theirs, field))
        assert np.array_equal(model.hfield_data, alone.hfield_data)
        for field in ("timestep", "gravity", "integrator", "cone", "jacobian", "solver", "iterations", "tolerance"):
            assert np.array_equal(getattr(model.opt, field), getattr(alone.opt, field)), field
