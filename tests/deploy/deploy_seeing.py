"""A hand-made policy that sees: two linear networks with memory, and their trace in float64 from the definitions."""

from __future__ import annotations

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

ROWS, COLUMNS, TERRAIN, HEADINGS, MEMORY, PERIOD, LATENCY = 6, 8, 4, 2, 3, 5, 5
FOCAL = 10.0 / np.tan(np.radians(43.5))
"""Of a sensor of 14 x 20 px with a horizontal field of view of 87 deg."""
TIMING = (
    "tick t counts policy steps since the start; where t is a multiple of period_ticks, image and obs of tick t enter "
    "the network; its outputs enter the policy from tick t + latency_ticks on, until the next ones do; zeros before"
)


def weights(size: int) -> dict[str, np.ndarray]:
    """Of the depth encoder (depth, obs, memory -> terrain, heading, memory) and of what the policy does with it."""
    rng = np.random.default_rng(5)
    shapes = {
        "terrain_depth": (ROWS * COLUMNS, TERRAIN),
        "terrain_memory": (MEMORY, TERRAIN),
        "heading_obs": (size, HEADINGS),
        "heading_memory": (MEMORY, HEADINGS),
        "memory_depth": (ROWS * COLUMNS, MEMORY),
        "action_terrain": (TERRAIN, 12),
        "action_heading": (HEADINGS, 12),
    }
    return {name: (0.2 * rng.standard_normal(shape)).astype(np.float32) for name, shape in shapes.items()}


def info(name: str, *shape: int) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)


def depth_onnx(size: int) -> bytes:
    """terrain = D A + m B; heading = 0.1 (obs H + m G); m' = m / 2 + D C, where D is the flat image."""
    constants = {name: value for name, value in weights(size).items() if not name.startswith("action")}
    constants |= {"half": np.full((1, 1), 0.5, np.float32), "tenth": np.full((1, 1), 0.1, np.float32)}
    node = helper.make_node
    nodes = [
        node("Flatten", ["depth"], ["flat"]),
        node("MatMul", ["flat", "terrain_depth"], ["t1"]),
        node("MatMul", ["memory_in", "terrain_memory"], ["t2"]),
        node("Add", ["t1", "t2"], ["terrain"]),
        node("MatMul", ["obs", "heading_obs"], ["h1"]),
        node("MatMul", ["memory_in", "heading_memory"], ["h2"]),
        node("Add", ["h1", "h2"], ["h3"]),
        node("Mul", ["h3", "tenth"], ["heading"]),
        node("Mul", ["memory_in", "half"], ["m1"]),
        node("MatMul", ["flat", "memory_depth"], ["m2"]),
        node("Add", ["m1", "m2"], ["memory_out"]),
    ]
    return _pack(
        nodes,
        [info("depth", 1, ROWS, COLUMNS), info("obs", 1, size), info("memory_in", 1, MEMORY)],
        [info("terrain", 1, TERRAIN), info("heading", 1, HEADINGS), info("memory_out", 1, MEMORY)],
        constants,
    )


def seeing_policy(blind: bytes, size: int) -> bytes:
    """The blind network, with 0.3 (terrain T + heading U) added to its action."""
    model = onnx.load_from_string(blind)
    graph = model.graph
    for value in graph.node:
        value.output[:] = ["blind_action" if name == "action" else name for name in value.output]
    node = helper.make_node
    graph.node.extend(
        [
            node("MatMul", ["terrain", "action_terrain"], ["a1"]),
            node("MatMul", ["heading", "action_heading"], ["a2"]),
            node("Add", ["a1", "a2"], ["a3"]),
            node("Mul", ["a3", "share"], ["a4"]),
            node("Add", ["blind_action", "a4"], ["action"]),
        ]
    )
    graph.input.extend([info("terrain", 1, TERRAIN), info("heading", 1, HEADINGS)])
    constants = {name: value for name, value in weights(size).items() if name.startswith("action")}
    constants["share"] = np.full((1, 1), 0.3, np.float32)
    graph.initializer.extend([numpy_helper.from_array(value, name) for name, value in constants.items()])
    onnx.checker.check_model(model)
    return model.SerializeToString()


def _pack(nodes: list, inputs: list, outputs: list, constants: dict[str, np.ndarray]) -> bytes:
    tensors = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "eye", inputs, outputs, tensors)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    onnx.checker.check_model(model)
    return model.SerializeToString()


class Eye:
    """The depth encoder and the policy's use of it, in float64."""

    def __init__(self, size: int) -> None:
        self.w = {name: value.astype(np.float64) for name, value in weights(size).items()}
        self.reset()

    def reset(self) -> None:
        self.tick, self.memory = 0, np.zeros(MEMORY)
        self.made: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def step(self, obs: np.ndarray, image: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """What is in use at this tick; an image comes at every fifth one."""
        w = self.w
        if self.tick % PERIOD == 0:
            flat = image.reshape(-1).astype(np.float64)
            terrain = flat @ w["terrain_depth"] + self.memory @ w["terrain_memory"]
            heading = 0.1 * (obs @ w["heading_obs"] + self.memory @ w["heading_memory"])
            self.memory = self.memory / 2 + flat @ w["memory_depth"]
            self.made[self.tick] = terrain, heading
        usable = [tick for tick in self.made if tick + LATENCY <= self.tick]
        self.tick += 1
        return self.made[max(usable)] if usable else (np.zeros(TERRAIN), np.zeros(HEADINGS))

    def action(self, seen: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """What it adds to the action of the blind policy."""
        return 0.3 * (seen[0] @ self.w["action_terrain"] + seen[1] @ self.w["action_heading"])


def depth_section(size: int) -> dict:
    """The section "depth" of the manifest."""
    return {
        "file": "depth_encoder.onnx",
        "inputs": {"depth": [1, ROWS, COLUMNS], "obs": [1, size]},
        "outputs": {"terrain": [1, TERRAIN], "heading": [1, HEADINGS]},
        "state": [
            {
                "input": "memory_in",
                "output": "memory_out",
                "shape": [1, MEMORY],
                "init": "zeros",
                "reset": "start",
            }
        ],
        "period_ticks": PERIOD,
        "latency_ticks": LATENCY,
        "timing": TIMING,
        "image": {
            "rows": ROWS,
            "columns": COLUMNS,
            "rule": "(clip(depth, near, far) - near) / (far - near) - 0.5",
            "invalid": "far",
        },
        "camera": {
            "position": [0.27, 0.0, 0.03],
            "pitch": [-0.1, 0.3],
            "fx": FOCAL / 2,
            "fy": FOCAL / 2,
            "cx": 4.0,
            "cy": 3.5,
            "near": 0.0,
            "far": 2.0,
            "raw_size": [14, 20],
            "crop_bottom": 2,
            "crop_sides": 2,
        },
        "heading": {"limit": 1.0, "unit": "rad", "frame": "base, about the vertical"},
    }
