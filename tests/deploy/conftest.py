"""A hand-made bundle: a quadruped of boxes, and a small open-loop trot with recurrent state as its policy."""

from __future__ import annotations

import hashlib
import io
import json
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

sys.path.insert(0, str(Path(__file__).parent))  # importlib mode does not

from deploy.interfaces import DepthFrame, RobotSpec, RobotState
from deploy_seeing import COLUMNS, HEADINGS, PERIOD, ROWS, TERRAIN, Eye, depth_onnx, depth_section, seeing_policy

LEGS = ("FL", "FR", "RL", "RR")
PARTS = ("hip", "thigh", "calf")
JOINTS = tuple(f"{leg}_{part}_joint" for leg in LEGS for part in PARTS)
RANGE = {"hip": (-0.9, 0.9), "thigh": (-1.5, 3.0), "calf": (-2.7, -0.5)}
STANCE = {"hip": 0.0, "thigh": 0.8, "calf": -1.6}
KP, KD, TORQUE, MASS = 80.0, 2.0, 30.0, 14.0
HEIGHT = 0.4 * np.cos(0.8) + 0.02
TICK = 0.02
TERMS = (
    ("base_angular_velocity", 3, 0.25),
    ("projected_gravity", 3, 1.0),
    ("command", 3, 2.0),
    ("joint_position_error", 12, 1.0),
    ("joint_velocity", 12, 0.05),
    ("last_action", 12, 1.0),
)
SIZE = 45


def leg_xml(leg: str) -> str:
    x = 0.2 if leg[0] == "F" else -0.2
    y = 0.1 if leg[1] == "L" else -0.1

    def joint(part: str, axis: str) -> str:
        low, high = RANGE[part]
        name = f"{leg}_{part}_joint"
        return f'<joint name="{name}" axis="{axis}" range="{low} {high}" armature="0.01" damping="0.1"/>'

    return f"""
    <body pos="{x} {y} 0">{joint("hip", "1 0 0")}
      <inertial pos="0 0 0" mass="0.2" diaginertia="1e-3 1e-3 1e-3"/>
      <body>{joint("thigh", "0 1 0")}
        <geom type="box" size=".015 .015 .1" pos="0 0 -.1" mass=".2" contype="0" conaffinity="0"/>
        <body pos="0 0 -.2">{joint("calf", "0 1 0")}
          <geom type="box" size=".01 .01 .1" pos="0 0 -.1" mass=".1" contype="0" conaffinity="0"/>
          <geom type="sphere" size=".02" pos="0 0 -.2" mass="0" friction="1 .01 .001"/>
          <site name="{leg}_foot" pos="0 0 -.2"/>
        </body></body></body>"""


def scene_xml(order: tuple[str, ...] = JOINTS, timestep: float = 0.005) -> str:
    servos = "".join(
        f'<position name="{name}" joint="{name}" kp="{KP}" kv="{KD}" forcerange="{-TORQUE} {TORQUE}"/>'
        for name in order
    )
    return f"""<mujoco model="box">
  <compiler angle="radian"/>
  <option timestep="{timestep}" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="50 50 .1"/>
    <body name="base" pos="0 0 {HEIGHT}"><freejoint/>
      <geom type="box" size=".22 .08 .05" mass="12" />
      {"".join(leg_xml(leg) for leg in LEGS)}
    </body>
  </worldbody>
  <actuator>{servos}</actuator>
</mujoco>"""


def urdf() -> bytes:
    """Joints and their limits; no shapes."""
    joints = "".join(
        f'<joint name="{name}" type="revolute"><limit lower="{RANGE[part][0]}" upper="{RANGE[part][1]}" '
        f'effort="{TORQUE}" velocity="20"/></joint>'
        for name in JOINTS
        for part in [name.split("_")[1]]
    )
    return f'<robot name="box">{joints}</robot>'.encode()


def trot_onnx() -> bytes:
    """action = a(phase) + W obs, phase' = phase + step, and a low pass of obs as a second state."""
    rng = np.random.default_rng(0)
    diagonal = np.repeat([0.0, np.pi, np.pi, 0.0], 3)
    lag = np.tile([0.0, 0.0, np.pi / 2], 4)
    amplitude = np.tile([0.0, 0.4, 0.45], 4)
    constants = {
        "step": np.full((1, 1), 2 * np.pi * 2.5 * TICK),
        "offset": (diagonal + lag)[None],
        "amplitude": amplitude[None],
        "w": 0.002 * rng.standard_normal((SIZE, 12)),
        "keep": np.full((1, 1), 0.9),
        "v": 0.01 * rng.standard_normal((SIZE, 3)),
    }
    nodes = [
        helper.make_node("Add", ["phase_in", "step"], ["phase_out"]),
        helper.make_node("Add", ["phase_in", "offset"], ["angle"]),
        helper.make_node("Sin", ["angle"], ["wave"]),
        helper.make_node("Mul", ["wave", "amplitude"], ["swing"]),
        helper.make_node("Mul", ["smooth_in", "keep"], ["kept"]),
        helper.make_node("Add", ["kept", "obs"], ["smooth_out"]),
        helper.make_node("MatMul", ["smooth_out", "w"], ["feedback"]),
        helper.make_node("Add", ["swing", "feedback"], ["action"]),
        helper.make_node("MatMul", ["smooth_out", "v"], ["velocity"]),
    ]

    def info(name: str, *shape: int) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    graph = helper.make_graph(
        nodes,
        "trot",
        [info("obs", 1, SIZE), info("phase_in", 1, 1), info("smooth_in", 1, SIZE)],
        [info("action", 1, 12), info("velocity", 1, 3), info("phase_out", 1, 1), info("smooth_out", 1, SIZE)],
        [numpy_helper.from_array(value.astype(np.float32), name) for name, value in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.checker.check_model(model)
    return model.SerializeToString()


def reference_golden(ticks: int = 24, sees: bool = False) -> dict[str, np.ndarray]:
    """The trace in float64 from the definitions alone: no code of the package, no onnxruntime."""
    rng = np.random.default_rng(1)
    model = onnx.load_from_string(trot_onnx())
    const = {t.name: numpy_helper.to_array(t).astype(np.float64) for t in model.graph.initializer}
    quat = rng.standard_normal((ticks, 4)) * 0.1 + [1, 0, 0, 0]
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    stance = np.tile([STANCE[part] for part in PARTS], 4)
    offset = stance + np.tile([0.0, 0.0, 0.05], 4)
    trace = {
        "quat_wxyz": quat,
        "gyro": rng.standard_normal((ticks, 3)),
        "q": stance + 0.2 * rng.standard_normal((ticks, 12)),
        "dq": 3.0 * rng.standard_normal((ticks, 12)),
        "command": rng.uniform(-0.5, 0.5, (ticks, 3)),
        "reset": np.isin(np.arange(ticks), [0, ticks // 2]),
        "obs": np.zeros((ticks, SIZE)),
        "action": np.zeros((ticks, 12)),
        "target": np.zeros((ticks, 12)),
    }
    eye = Eye(SIZE)
    since = np.arange(ticks) % (ticks // 2)
    if sees:
        trace["depth_due"] = since % PERIOD == 0
        trace["depth"] = rng.uniform(-0.5, 0.5, (int(trace["depth_due"].sum()), ROWS, COLUMNS)).astype(np.float32)
        trace["terrain"], trace["heading"] = np.zeros((ticks, TERRAIN)), np.zeros((ticks, HEADINGS))
    for t in range(ticks):
        if trace["reset"][t]:
            phase, smooth, last = 0.0, np.zeros(SIZE), np.zeros(12)
            eye.reset()
        w, x, y, z = quat[t]
        down = -np.array([2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z])
        obs = np.concatenate(
            [
                trace["gyro"][t] * 0.25,
                down,
                trace["command"][t] * 2.0,
                trace["q"][t] - stance,
                trace["dq"][t] * 0.05,
                last,
            ]
        )
        smooth = 0.9 * smooth + obs
        last = const["amplitude"][0] * np.sin(phase + const["offset"][0]) + smooth @ const["w"]
        if sees:
            image = trace["depth"][trace["depth_due"][:t].sum()] if trace["depth_due"][t] else None
            trace["terrain"][t], trace["heading"][t] = seen = eye.step(obs, image)
            last = last + eye.action(seen)
        phase += const["step"][0, 0]
        trace["obs"][t], trace["action"][t], trace["target"][t] = obs, last, offset + 0.25 * last
    return trace


def npz_bytes(trace: dict[str, np.ndarray]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **trace)
    return buffer.getvalue()


def make_manifest() -> dict:
    return {
        "schema_version": 1,
        "name": "box trot",
        "created": "2026-01-02T03:04:05Z",
        "generator": {"package": "by hand", "version": "0", "commit": None, "torch": "none", "opset": 18},
        "files": {},
        "robot": {
            "name": "box",
            "urdf": "robot.urdf",
            "mjcf": "robot.xml",
            "scene": "scene.xml",
            "base": "base",
            "feet": [f"{leg}_foot" for leg in LEGS],
            "design": {"names": ["thigh", "calf"], "values": [1.0, 1.1]},
            "total_mass": MASS,
        },
        "joints": [
            {
                "name": name,
                "actuator": name,
                "stance": STANCE[name.split("_")[1]],
                "target_offset": STANCE[name.split("_")[1]] + (0.05 if "calf" in name else 0.0),
                "kp": KP,
                "kd": KD,
                "torque_limit": TORQUE,
                "velocity_limit": None,
                "lower": RANGE[name.split("_")[1]][0],
                "upper": RANGE[name.split("_")[1]][1],
            }
            for name in JOINTS
        ],
        "action": {"scale": 0.25, "clip": None, "rule": "target = target_offset + scale * clip(action)"},
        "rates": {"policy_hz": 50, "depth_hz": None, "physics_dt": 0.005},
        "start": {"height": HEIGHT, "quat_wxyz": [1, 0, 0, 0]},
        "command": {"names": ["vx", "vy", "yaw_rate"], "low": [-1, -1, -1], "high": [1, 1, 1]},
        "observation": {
            "terms": [
                {"name": name, "source": name, "frame": "base", "unit": "SI", "size": size, "scale": scale}
                for name, size, scale in TERMS
            ]
        },
        "policy": {
            "file": "policy.onnx",
            "inputs": {"obs": [1, SIZE]},
            "outputs": {"action": [1, 12], "velocity": [1, 3]},
            "state": [
                {"input": f"{name}_in", "output": f"{name}_out", "shape": [1, n], "init": "zeros", "reset": "start"}
                for name, n in (("phase", 1), ("smooth", SIZE))
            ],
        },
        "golden": {"file": "golden.npz", "ticks": 24, "atol": 1e-5},
        "training": {},
    }


class BundleFolder:
    """A bundle on disk that a test can spoil; `seal` writes the manifest with fresh hashes."""

    def __init__(self, root: Path, sees: bool = False) -> None:
        self.root = root
        self.manifest = make_manifest()
        self.files = {
            "policy.onnx": trot_onnx(),
            "robot.urdf": urdf(),
            "robot.xml": scene_xml().encode(),
            "scene.xml": scene_xml().encode(),
            "golden.npz": npz_bytes(reference_golden(sees=sees)),
        }
        if sees:
            self.manifest["depth"] = depth_section(SIZE)
            self.manifest["rates"]["depth_hz"] = 50 / PERIOD
            self.manifest["policy"]["inputs"] |= {"terrain": [1, TERRAIN], "heading": [1, HEADINGS]}
            self.files["depth_encoder.onnx"] = depth_onnx(SIZE)
            self.files["policy.onnx"] = seeing_policy(trot_onnx(), SIZE)

    def seal(self) -> Path:
        self.root.mkdir(exist_ok=True)
        for name, data in self.files.items():
            (self.root / name).write_bytes(data)
        self.manifest["files"] = {name: hashlib.sha256(data).hexdigest() for name, data in self.files.items()}
        write_manifest(self.root, self.manifest)
        return self.root


def write_manifest(root: Path, manifest: object) -> None:
    """Write the manifest of a bundle with its checksum as coreutils' `sha256sum manifest.json` prints it."""
    text = json.dumps(manifest)
    (root / "manifest.json").write_text(text)
    (root / "manifest.sha256").write_text(f"{hashlib.sha256(text.encode()).hexdigest()}  manifest.json\n")


@pytest.fixture
def folder(tmp_path):
    """A bundle folder not yet written."""
    return BundleFolder(tmp_path / "bundle")


@pytest.fixture(scope="session")
def bundle_dir(tmp_path_factory):
    """An intact bundle on disk, not to be changed."""
    return BundleFolder(tmp_path_factory.mktemp("intact") / "bundle").seal()


@pytest.fixture
def seeing_folder(tmp_path):
    """A bundle folder of a policy that sees, not yet written."""
    return BundleFolder(tmp_path / "seeing", sees=True)


@pytest.fixture(scope="session")
def seeing_dir(tmp_path_factory):
    """An intact bundle of a policy that sees, not to be changed."""
    return BundleFolder(tmp_path_factory.mktemp("intact") / "seeing", sees=True).seal()


@pytest.fixture
def golden():
    """The reference trace, to be altered."""
    return reference_golden()


@pytest.fixture
def pack():
    """Arrays to the bytes of an npz file."""
    return npz_bytes


@pytest.fixture
def make_scene():
    """MJCF text of the box quadruped, its actuators in any order."""
    return scene_xml


class FakeClock:
    """Time that passes only when told, or asked to sleep."""

    virtual = True

    def __init__(self) -> None:
        self.time = 0

    def now_ns(self) -> int:
        return self.time

    def sleep_until(self, time_ns: int) -> None:
        self.time = max(self.time, time_ns)


class FakeRobot:
    """Stands still in the stance, in an order of joints of its own; a test spoils its readings.

    `fault(state) -> state` alters what `read` returns, `eye(time_ns) -> frame` is its camera; `sent` and `damped`
    record what came.
    """

    def __init__(self, names: tuple[str, ...] = JOINTS) -> None:
        self.spec = RobotSpec("fake", names)
        self.clock = FakeClock()
        self.q = np.array([STANCE[name.split("_")[1]] for name in names])
        self.fault = lambda state: state
        self.eye = lambda time_ns: None
        self.sent = []
        self.damped = 0
        self.stopped = 0
        self.reads = 0

    def start(self) -> None:
        pass

    def stop(self) -> None:
        self.stopped += 1

    def read(self) -> RobotState:
        zeros = np.zeros(12)
        self.reads += 1
        return self.fault(
            RobotState(
                stamp_ns=self.clock.time,
                seq=self.reads,
                q=self.q.copy(),
                dq=zeros,
                tau=zeros,
                quat_wxyz=np.array([1.0, 0, 0, 0]),
                gyro=np.array([0, 0, 1e-6 * self.reads]),  # a living sensor has noise
                acc=np.array([0, 0, 9.81]),
            )
        )

    def read_depth(self) -> DepthFrame | None:
        return self.eye(self.clock.time)

    def write(self, command) -> None:
        self.sent.append(command)

    def damp(self) -> None:
        self.damped += 1


@pytest.fixture(scope="session")
def fake_robot():
    """Makes a fake robot with its joints in the given order."""
    return FakeRobot


@pytest.fixture(scope="session")
def make_clock():
    """Makes a fake clock."""
    return FakeClock


@pytest.fixture
def fake_clock():
    """A fake clock at 0."""
    return FakeClock()
