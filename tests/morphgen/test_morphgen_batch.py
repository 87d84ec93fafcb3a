"""Batched bodies against freshly compiled ones, and the contract of the batch."""

import mujoco
import mujoco.batch
import numpy as np
import pytest
from morphgen import MorphologyError, flat_scene
from numpy.testing import assert_allclose


def batched(batch):
    sims = mujoco.batch.Batch(batch.model, batch.n, 1)
    for name, values in batch.fields.items():
        sims.expand(name)[:] = values
    sims.set_const()
    return sims


def mass_matrix(model, data):
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return full


def box_scene():
    """A scene unlike the default: other options, a step of boxes, no plane named floor."""
    scene = mujoco.MjSpec()
    scene.option.timestep = 0.002
    scene.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    scene.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    scene.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    ground = scene.worldbody.add_body(name="ground")
    ground.add_geom(name="low", type=mujoco.mjtGeom.mjGEOM_BOX, size=[2, 2, 0.1], pos=[0, 0, -0.1])
    ground.add_geom(name="high", type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.1], pos=[1.25, 0, -0.08])
    return scene


@pytest.mark.parametrize("scene", [None, box_scene], ids=["flat", "boxes"])
def test_batched_bodies_are_the_compiled_ones(factory, designs, scene):
    designs = designs[::2]
    scene = None if scene is None else scene()
    batch = factory.batch(designs, scene)
    sims = batched(batch)
    sims.bind("qpos")[:] = batch.stance_qpos
    sims.bind("qpos")[:, 2] -= 0.003
    sims.bind("ctrl")[:] = batch.stance_ctrl
    for i, design in enumerate(designs):
        fresh = factory.spec(design, scene).compile()
        mine = sims.get_model(i)
        data = [mujoco.MjData(model) for model in (mine, fresh)]
        for model, state in zip((mine, fresh), data, strict=True):
            state.qpos[:] = batch.stance_qpos[i]
            state.qpos[2] -= 0.003
            state.qpos[7:] += 0.05 * np.sin(np.arange(12))
            mujoco.mj_forward(model, state)
        mass = [mass_matrix(model, state) for model, state in zip((mine, fresh), data, strict=True)]
        assert_allclose(mass[0], mass[1], atol=1e-12)
        for field in ("xpos", "xipos", "geom_xpos", "site_xpos", "cinert", "qfrc_bias", "qacc", "sensordata"):
            assert_allclose(getattr(data[0], field), getattr(data[1], field), rtol=1e-9, atol=1e-9)
        assert data[0].ncon == data[1].ncon
        assert_allclose(data[0].contact.dist, data[1].contact.dist, atol=1e-9)
        for field in ("geom_rbound", "geom_aabb", "body_invweight0", "dof_invweight0", "body_subtreemass"):
            assert_allclose(getattr(mine, field), getattr(fresh, field), rtol=1e-9, atol=1e-12)
    final = []
    for i, design in enumerate(designs):
        fresh = factory.spec(design, scene).compile()
        state = mujoco.MjData(fresh)
        state.qpos[:] = batch.stance_qpos[i]
        state.qpos[2] -= 0.003
        state.ctrl[:] = batch.stance_ctrl[i]
        mujoco.mj_step(fresh, state, 100)
        final.append(state.qpos.copy())
        assert state.ncon >= 1
    sims.step(nstep=100)
    assert_allclose(sims.bind("qpos"), final, rtol=0, atol=1e-9)


def test_set_const_derives_every_field_that_is_not_listed(factory):
    """With the batch's fields written, no array of the model differs from a fresh compilation."""
    design = np.array([1.3, 0.8, 0.7, 1.2])
    batch = factory.batch(design)
    fresh, mine = factory.spec(design).compile(), batched(batch).get_model(0)
    for name in (name for name in dir(fresh) if not name.startswith("_")):
        value = getattr(fresh, name)
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            assert_allclose(getattr(mine, name), value, rtol=1e-12, atol=1e-15, err_msg=name)
    for name, values in batch.fields.items():
        assert not np.array_equal(values[0], getattr(batch.model, name))


def test_layout_names_the_compiled_model(factory):
    model, layout = factory.batch(np.ones(4)).model, factory.layout
    assert (model.nq, model.nv, model.nu) == (19, 18, 12)
    assert [model.joint(name).qposadr[0] for name in layout.joints] == list(range(7, 19))
    assert [model.joint(name).dofadr[0] for name in layout.joints] == list(range(6, 18))
    assert [model.actuator(name).id for name in layout.actuators] == list(range(12))
    assert layout.joints[:4] == ("FL_hip_joint", "FL_thigh_joint", "FL_calf_joint", "FR_hip_joint")
    for name in (*layout.foot_contact, *layout.link_contact):
        sensor = model.sensor(name)
        size = 4 if name in layout.foot_contact else 1
        assert (sensor.type[0], sensor.dim[0]) == (mujoco.mjtSensor.mjSENS_CONTACT, size)
    assert [model.sensor(name).dim[0] for name in layout.imu.values()] == [3, 3, 4]
    for name, leg in zip(layout.links, layout.link_leg, strict=True):
        model.body(name)
        assert name.startswith(("FL", "FR", "RL", "RR")[leg]) if leg >= 0 else name == layout.base


def test_contact_sensors_tell_feet_from_links(factory):
    batch = factory.batch(np.ones(4))
    data = mujoco.MjData(batch.model)

    def counts(names):
        return np.array([data.sensor(name).data[0] for name in names])

    data.qpos[:] = batch.stance_qpos[0]
    data.qpos[2] -= 0.002
    mujoco.mj_forward(batch.model, data)
    assert counts(factory.layout.foot_contact).tolist() == [1, 1, 1, 1]
    assert not counts(factory.layout.link_contact).any()
    data.qpos[2] = 0.04  # trunk and folded legs in the floor
    mujoco.mj_forward(batch.model, data)
    touched = dict(zip(factory.layout.links, counts(factory.layout.link_contact) > 0, strict=True))
    assert touched["base"]
    assert touched["FL_hip"]
    assert touched["RR_calf"]


def test_the_feet_of_a_standing_robot_press_down_with_its_weight(factory):
    batch = factory.batch(np.ones(4))
    data = mujoco.MjData(batch.model)
    data.qpos[:], data.ctrl[:] = batch.stance_qpos[0], batch.stance_ctrl[0]
    mujoco.mj_step(batch.model, data, nstep=1000)
    force = np.array([data.sensor(name).data[1:] for name in factory.layout.foot_contact])
    np.testing.assert_allclose(force.sum(axis=0), (0.0, 0.0, -9.81 * batch.total_mass[0]), atol=0.05)
    assert (force[:, 2] < -20.0).all()


def test_robot_does_not_collide_with_itself(factory):
    batch = factory.batch(np.ones(4))
    data = mujoco.MjData(batch.model)
    data.qpos[:] = batch.stance_qpos[0]
    data.qpos[2] = 2.0
    data.qpos[7::3] = (-1.0, 1.0, -1.0, 1.0)  # legs crossed under the trunk
    mujoco.mj_forward(batch.model, data)
    assert data.ncon == 0


def test_mirrored_joint_angles_give_mirrored_feet(factory):
    model, layout = factory.batch((0.8, 1.2, 1.1, 0.9)).model, factory.layout
    mirror, sign = np.array(layout.mirror_joint), np.array(layout.mirror_sign)
    rng = np.random.default_rng(2)
    q = rng.uniform(-0.5, 0.5, 12) + np.tile([0, 0.8, -1.5], 4)
    feet = []
    for angles in (q, sign * q[mirror]):
        data = mujoco.MjData(model)
        data.qpos[7:] = angles
        mujoco.mj_kinematics(model, data)
        feet.append(np.array([data.site(name).xpos for name in layout.feet]))
    assert_allclose(feet[1], feet[0][[1, 0, 3, 2]] * (1, -1, 1), atol=1e-12)


def test_servo_is_a_pd_controller_with_a_torque_limit(factory):
    batch = factory.batch(np.ones(4))
    model, data = batch.model, mujoco.MjData(batch.model)
    data.qpos[:] = batch.stance_qpos[0]
    data.qpos[2] = 1.0
    data.qvel[6:] = 0.5
    data.ctrl[:] = data.qpos[7:] + 0.1
    mujoco.mj_forward(model, data)
    assert_allclose(data.actuator_force, 40 * 0.1 - 0.7 * 0.5)
    data.ctrl[:] = data.qpos[7:] + 10
    mujoco.mj_forward(model, data)
    assert_allclose(data.actuator_force, np.tile([23.7, 23.7, 45.43], 4))
    assert_allclose(batch.torque_limit[0], np.tile([23.7, 23.7, 45.43], 4))
    assert_allclose(batch.velocity_limit[0], np.tile([30.1, 30.1, 15.70], 4))
    assert_allclose(model.dof_armature[6:], 0.01)
    assert_allclose(model.dof_damping[6:], 0.1)
    assert_allclose(model.dof_frictionloss[6:], 0.1)


def test_scene_options_win_and_the_scene_stays_as_it_was(factory):
    scene = box_scene()
    model = factory.batch(np.ones(4), scene).model
    assert model.opt.timestep == 0.002
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    assert len(scene.bodies) == 2
    assert flat_scene().compile().opt.timestep == 0.005


def test_total_mass_is_that_of_the_compiled_model(factory, designs):
    batch = factory.batch(designs)
    for mass, design in zip(batch.total_mass, designs, strict=True):
        assert mass == pytest.approx(factory.spec(design).compile().body_subtreemass[0], rel=1e-12)


def test_repeated_designs_are_the_same_bodies(factory, designs):
    rows = np.array([2, 0, 2, 1, 1, 0])
    repeated = factory.batch(designs[rows])
    for i, row in enumerate(rows):
        alone = factory.batch(designs[row])
        assert np.array_equal(repeated.designs[i], designs[row])
        assert all(np.array_equal(values[i], alone.fields[name][0]) for name, values in repeated.fields.items())
        assert np.array_equal(repeated.stance_qpos[i], alone.stance_qpos[0])
        assert np.array_equal(repeated.stance_ctrl[i], alone.stance_ctrl[0])


def test_take_selects_rows_of_everything(factory, designs):
    batch = factory.batch(designs)
    ids = np.array([4, 0, 4, 20])
    part = batch.take(ids)
    assert part.n == 4
    assert part.model is batch.model
    direct = factory.batch(designs[ids])
    for name in ("designs", "stance_qpos", "stance_ctrl", "feasible", "kp", "total_mass", "hip_height"):
        assert np.array_equal(getattr(part, name), getattr(direct, name))
    assert part.fields.keys() == direct.fields.keys()
    for name, values in part.fields.items():
        assert np.array_equal(values, direct.fields[name])
    assert batch.take(np.array([], dtype=int)).n == 0
    with pytest.raises(TypeError, match="vector of integers"):
        batch.take([True, False])
    with pytest.raises(IndexError):
        batch.take([len(designs)])


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ([[1, 1, 1, 1], [1, 1.5, 1, 1]], r"design 1: front_shank = 1.5 is outside \[0.6, 1.4\]"),
        ([1, 1, 1, float("nan")], "hind_shank = nan"),
        ([1, 1, 1], r"shape \(n, 4\) in the order front_thigh"),
        (np.ones((2, 2, 4)), r"shape \(n, 4\)"),
        (["a", 1, 1, 1], "must be numbers"),
    ],
)
def test_bad_designs_name_row_and_parameter(factory, bad, message):
    with pytest.raises(MorphologyError, match=message):
        factory.batch(bad)


def test_space_contains_its_bounds_and_not_nan(factory):
    inside = factory.space.contains([[0.6] * 4, [1.4] * 4, [1, 1, 1, 1.41], [np.nan, 1, 1, 1]])
    assert inside.tolist() == [True, True, False, False]
