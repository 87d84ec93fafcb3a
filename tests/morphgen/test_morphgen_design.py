"""What each design parameter does to the exported URDF, compiled by MuJoCo alone, and what it leaves."""

import mujoco
import numpy as np
import pytest
from morphgen import PARAMETERS, DesignSpace, MorphologyError, go2, load_robot
from morphgen.robots import GO2
from morphgen.scaling.design import BOUNDS
from numpy.testing import assert_allclose
from plain_mujoco import compile_urdf

LEGS = ("FL", "FR", "RL", "RR")
FRONT, HIND = LEGS[:2], LEGS[2:]


def factory(name: str, rule: str = "stretch"):
    low = 0.0 if name == "motor_placement" else 0.5
    return load_robot("go2", rule=rule, space=DesignSpace.of(**{name: (low, 2.0)}))


class Parts:
    """Numbers of a compiled model by the name of the link, everything about its body frame."""

    def __init__(self, text: str) -> None:
        model = compile_urdf(text)
        self.names = [model.body(i).name for i in range(1, model.nbody)]
        self.mass, self.com, self.inertia, self.place, self.geoms = {}, {}, {}, {}, {}
        for name in self.names:
            body = model.body(name)
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, body.iquat)
            turn = turn.reshape(3, 3)
            self.mass[name] = float(body.mass[0])
            self.com[name] = body.ipos.copy()
            self.inertia[name] = turn @ np.diag(body.inertia) @ turn.T
            self.place[name] = np.concatenate([body.pos, body.quat])
            ids = np.flatnonzero(model.geom_bodyid == body.id)
            self.geoms[name] = [
                (int(model.geom_type[g]), *model.geom_size[g], *model.geom_pos[g], *model.geom_quat[g]) for g in ids
            ]
        self.joints = [
            (model.joint(j).name, *model.jnt_axis[j], *model.jnt_range[j], *model.jnt_actfrcrange[j])
            for j in range(1, model.njnt)
        ]
        self.damping = model.dof_damping.copy()
        self.friction = model.dof_frictionloss.copy()


class Edit:
    """The nominal robot with changes applied by hand."""

    def __init__(self, parts: Parts) -> None:
        self.parts = parts

    def stretch(self, link: str, axis: int, scale: float, mass: float) -> None:
        """Every point of a link moves along a coordinate axis of it; its mass grows by a factor."""
        parts, s = self.parts, np.eye(3)
        s[axis, axis] = scale
        inertia = parts.inertia[link]
        sigma = mass * s @ (np.trace(inertia) / 2 * np.eye(3) - inertia) @ s
        parts.inertia[link] = np.trace(sigma) * np.eye(3) - sigma
        parts.mass[link] *= mass
        parts.com[link] = s @ parts.com[link]
        geoms = []
        for kind, *numbers in parts.geoms[link]:
            size, position, quat = (np.array(v) for v in (numbers[:3], numbers[3:6], numbers[6:]))
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, quat)
            along = int(np.argmax(np.abs(turn.reshape(3, 3)[axis])))
            # a cylinder along the axis: radius, half length; a box: half sides
            size[1 if kind == mujoco.mjtGeom.mjGEOM_CYLINDER else along] *= scale
            geoms.append((kind, *size, *(s @ position), *quat))
        parts.geoms[link] = geoms

    def move(self, link: str, axis: int, scale: float) -> None:
        """Where a link hangs on its parent."""
        self.parts.place[link][axis] *= scale

    def weigh(self, link: str, factor: float) -> None:
        self.parts.mass[link] *= factor
        self.parts.inertia[link] = self.parts.inertia[link] * factor

    def thigh(self, leg: str, scale: float) -> None:
        self.stretch(f"{leg}_thigh", 2, scale, scale)
        self.move(f"{leg}_calf", 2, scale)

    def shank(self, leg: str, scale: float) -> None:
        self.stretch(f"{leg}_calf", 2, scale, scale)
        self.move(f"{leg}_foot", 2, scale)

    def hip(self, leg: str, scale: float) -> None:
        self.stretch(f"{leg}_hip", 1, scale, 1.0)
        self.move(f"{leg}_thigh", 1, scale)

    def trunk(self, scale: float) -> None:
        self.stretch("base", 0, scale, 1.0)
        for leg in LEGS:
            self.move(f"{leg}_hip", 0, scale)

    def foot(self, leg: str, scale: float) -> None:
        """A solid ball."""
        name = f"{leg}_foot"
        self.parts.mass[name] *= scale**3
        self.parts.inertia[name] = self.parts.inertia[name] * scale**5
        self.parts.geoms[name] = [(kind, radius * scale, *rest) for kind, radius, *rest in self.parts.geoms[name]]


def each(names, change):
    def apply(edit: Edit, value: float) -> None:
        for name in names:
            change(edit, name, value)

    return apply


EFFECTS = {
    "front_thigh": each(FRONT, Edit.thigh),
    "front_shank": each(FRONT, Edit.shank),
    "hind_thigh": each(HIND, Edit.thigh),
    "hind_shank": each(HIND, Edit.shank),
    **{f"{leg.lower()}_thigh": each([leg], Edit.thigh) for leg in LEGS},
    **{f"{leg.lower()}_shank": each([leg], Edit.shank) for leg in LEGS},
    "hip_offset": each(LEGS, Edit.hip),
    "trunk_length": Edit.trunk,
    "trunk_mass": each(["base"], Edit.weigh),
    "hip_mass": each([f"{leg}_hip" for leg in LEGS], Edit.weigh),
    "thigh_mass": each([f"{leg}_thigh" for leg in LEGS], Edit.weigh),
    "shank_mass": each([f"{leg}_calf" for leg in LEGS], Edit.weigh),
    "foot_radius": each(LEGS, Edit.foot),
}


def assert_same(parts: Parts, expected: Parts) -> None:
    assert parts.names == expected.names
    assert parts.joints == expected.joints
    assert np.array_equal(parts.damping, expected.damping)
    assert np.array_equal(parts.friction, expected.friction)
    for name in parts.names:
        assert parts.mass[name] == pytest.approx(expected.mass[name], rel=1e-12), name
        scale = np.trace(expected.inertia[name])
        assert_allclose(parts.inertia[name], expected.inertia[name], atol=1e-10 * scale, err_msg=name)
        assert_allclose(parts.com[name], expected.com[name], atol=1e-14, err_msg=name)
        assert_allclose(parts.place[name], expected.place[name], atol=1e-14, err_msg=name)
        assert_allclose(parts.geoms[name], expected.geoms[name], atol=1e-12, err_msg=name)


@pytest.mark.parametrize("value", [0.7, 1.3])
@pytest.mark.parametrize("name", EFFECTS)
def test_a_parameter_does_what_its_text_says_and_nothing_else(name, value):
    robot = factory(name)
    expected = Parts(robot.urdf([1.0]))
    EFFECTS[name](Edit(expected), value)
    assert_same(Parts(robot.urdf([value])), expected)


def test_every_parameter_has_such_a_test_and_usual_bounds():
    assert set(PARAMETERS) == {*EFFECTS, "motor_placement"} == set(BOUNDS)
    assert all(PARAMETERS.values())


@pytest.mark.parametrize("value", [0.4, 1.0])
def test_motor_placement_moves_the_motor_of_the_thigh_and_nothing_else(value):
    """Go2's thigh: rod m c / (L / 2), the rest moves down by value times L."""
    robot = factory("motor_placement", "lumped")
    parts, expected = Parts(robot.urdf([value])), Parts(robot.urdf([0.0]))
    vendor = GO2.thigh.vendor
    rod = vendor.mass * 0.0327 / (0.213 / 2)
    motor, way = vendor.mass - rod, np.array([0, 0, -0.213 * value])
    for leg in LEGS:
        name = f"{leg}_thigh"
        com, inertia = expected.com[name], expected.inertia[name]
        second = np.trace(inertia) / 2 * np.eye(3) - inertia + vendor.mass * np.outer(com, com)
        # of the motor: first moment about the joint, from the whole less the rod
        first = vendor.mass * com - rod * np.array([0, 0, -0.213 / 2])
        second += np.outer(way, first) + np.outer(first, way) + motor * np.outer(way, way)
        new = com + motor * way / vendor.mass
        sigma = second - vendor.mass * np.outer(new, new)
        expected.com[name], expected.inertia[name] = new, np.trace(sigma) * np.eye(3) - sigma
        assert parts.com[name][2] - com[2] == pytest.approx(-motor / vendor.mass * value * 0.213, rel=1e-9)
    assert_same(parts, expected)


@pytest.mark.parametrize("rule", ["paper", "stretch"])
def test_motor_placement_needs_the_rule_that_has_a_motor(rule):
    with pytest.raises(MorphologyError, match="motor_placement moves the motor of rule 'lumped'"):
        factory("motor_placement", rule)


@pytest.mark.parametrize("rule", ["paper", "stretch", "lumped"])
def test_parameters_act_together(rule):
    """A leg's scale multiplies its pair's; mass is of length and factor; the rest of the robot stays."""
    space = DesignSpace.of(
        front_thigh=(0.5, 2), fl_thigh=(0.5, 2), rr_shank=(0.5, 2), thigh_mass=(0.5, 2), trunk_mass=(0.5, 2)
    )
    robot = load_robot("go2", rule=rule, space=space)
    before, after = Parts(robot.urdf(space.nominal)), Parts(robot.urdf([1.2, 1.5, 0.6, 1.1, 0.9]))
    for leg, thigh, shank in (("FL", 1.8, 1), ("FR", 1.2, 1), ("RL", 1, 1), ("RR", 1, 0.6)):
        assert after.place[f"{leg}_calf"][2] == pytest.approx(-0.213 * thigh, rel=1e-12)
        assert after.place[f"{leg}_foot"][2] == pytest.approx(-0.213 * shank, rel=1e-12)
        grown = {"thigh": after.mass[f"{leg}_thigh"] / 1.152, "calf": after.mass[f"{leg}_calf"] / 0.154}
        if rule != "lumped":
            assert grown["thigh"] == pytest.approx(thigh * 1.1, rel=1e-12)
            assert grown["calf"] == pytest.approx(shank, rel=1e-12)
        else:  # only the rod's share follows the length
            share = 0.0327 / (0.213 / 2)
            assert grown["thigh"] == pytest.approx((1 + share * (thigh - 1)) * 1.1, rel=1e-9)
        for part in ("hip", "foot"):
            name = f"{leg}_{part}"
            assert after.mass[name] == before.mass[name]
            assert np.array_equal(after.inertia[name], before.inertia[name])
    assert after.mass["base"] == pytest.approx(0.9 * before.mass["base"], rel=1e-12)


def test_the_paper_rule_takes_a_wider_space():
    """Table II for the legs, the rest as under any rule; the batch agrees with the body by itself."""
    space = DesignSpace.wide()
    robot = load_robot("go2", rule="paper", space=space)
    designs = space.sample(4, np.random.default_rng(1))
    bodies = robot.batch(designs)
    for row, design in enumerate(designs):
        value = dict(zip(space.names, design, strict=True))
        parts = Parts(robot.urdf(design))
        mass = 1.152 * value["front_thigh"] * value["thigh_mass"]
        length = 0.213 * value["front_thigh"]
        swing, twist = mass / 12 * (0.029**2 + length**2), mass / 6 * 0.029**2
        assert parts.mass["FL_thigh"] == pytest.approx(mass, rel=1e-12)
        assert_allclose(parts.inertia["FL_thigh"], np.diag([swing, swing, twist]), rtol=1e-9, atol=1e-12)
        assert bodies.total_mass[row] == pytest.approx(sum(parts.mass.values()), rel=1e-12)


def test_spaces_by_name():
    four = DesignSpace.leg_scales(0.5, 1.5)
    assert four.names == ("front_thigh", "front_shank", "hind_thigh", "hind_shank")
    assert four.low.tolist() == [0.5] * 4
    assert four.high.tolist() == [1.5] * 4
    eight = DesignSpace.per_leg()
    assert set(eight.names) == {f"{leg.lower()}_{part}" for leg in LEGS for part in ("thigh", "shank")}
    wide = DesignSpace.wide()
    assert wide.names[:4] == four.names
    assert {"hip_offset", "trunk_length", "foot_radius", "trunk_mass"} <= set(wide.names)
    assert "motor_placement" not in wide.names  # it would bind the space to a rule
    custom = DesignSpace.of(trunk_length=(0.9, 1.1), motor_placement=(0, 0.5))
    assert custom.nominal.tolist() == [1, 0]
    assert custom.dim == 2


@pytest.mark.parametrize("space", [DesignSpace.leg_scales(), DesignSpace.per_leg(), DesignSpace.wide()])
def test_the_nominal_design_is_the_robot_itself(space):
    for rule in ("paper", "stretch", "lumped"):
        robot = load_robot("go2", rule=rule, space=space)
        assert robot.urdf(space.nominal) == load_robot("go2", rule=rule).urdf(np.ones(4))


@pytest.mark.parametrize(
    ("names", "low", "high", "nominal", "message"),
    [
        (("thigh",), 0.6, 1.4, 1, "unknown parameter 'thigh'; known: front_thigh"),
        (("hip_mass", "hip_mass"), 0.6, 1.4, 1, "different names"),
        ((), 0.6, 1.4, 1, "different names"),
        (("hip_mass",), 1.1, 1.4, 1, "low <= nominal <= high"),
        (("hip_mass",), 1.4, 0.6, 1, "low <= nominal <= high"),
        (("hip_mass",), float("nan"), 1.4, 1, "low <= nominal <= high"),
        (("hip_mass",), 0.6, float("inf"), 1, "must be finite"),
        (("hip_mass",), 0.0, 1.4, 1, "'hip_mass' must be positive, its lower bound is 0"),
        (("foot_radius",), -1, 1.4, 1, "'foot_radius' must be positive"),
    ],
)
def test_impossible_spaces_are_refused(names, low, high, nominal, message):
    values = [np.full(len(names), v) for v in (low, high, nominal)]
    with pytest.raises(MorphologyError, match=message):
        DesignSpace(names, *values)


def test_bounds_of_another_shape_are_refused():
    with pytest.raises(MorphologyError, match="low needs 1 values"):
        DesignSpace(("hip_mass",), np.ones(2), np.ones(1), np.ones(1))


def test_bounds_are_copied_and_cannot_be_changed():
    low = np.array([0.6])
    space = DesignSpace(("hip_mass",), low, np.array([1.4]), np.array([1.0]))
    low[0] = 2
    assert space.low[0] == 0.6
    with pytest.raises(ValueError, match="read-only"):
        space.high[0] = 3


def test_samples_fill_the_space():
    space = DesignSpace.of(front_thigh=(0.8, 1.2), trunk_length=(0.5, 1.0), motor_placement=(-0.5, 1.5))
    designs = space.sample(4000, np.random.default_rng(0))
    assert designs.shape == (4000, 3)
    assert space.contains(designs).all()
    assert_allclose(designs.mean(axis=0), (space.low + space.high) / 2, atol=0.03)
    assert_allclose(designs.min(axis=0), space.low, atol=0.01)
    assert_allclose(designs.max(axis=0), space.high, atol=0.01)
    assert np.array_equal(designs, space.sample(4000, np.random.default_rng(0)))


def test_a_factory_samples_feasible_bodies_only():
    """From a space where many are not: very long front shanks on short thighs."""
    space = DesignSpace.leg_scales(0.3, 2.0)
    robot = load_robot("go2", space=space)
    assert not robot.feasible(space.sample(200, np.random.default_rng(0))).all()
    designs = robot.sample(50, np.random.default_rng(0))
    assert designs.shape == (50, 4)
    assert robot.feasible(designs).all()
    assert robot.batch(designs).feasible.all()
    assert np.array_equal(designs, robot.sample(50, np.random.default_rng(0)))


@pytest.mark.slow
def test_a_space_of_unsound_bodies_is_given_up():
    robot = load_robot("go2", space=DesignSpace.of(trunk_mass=(1.0, 1e6)))
    with pytest.raises(MorphologyError, match=r"go2: only 0 of \d+ designs .* narrow"):
        robot.sample(64, np.random.default_rng(0))


def test_one_design_is_one_row():
    robot = go2()
    assert robot.urdf([[1, 1.1, 1, 1]]) == robot.urdf([1, 1.1, 1, 1])
    with pytest.raises(MorphologyError, match="expected one design of 4 values, got 2"):
        robot.urdf(np.ones((2, 4)))
