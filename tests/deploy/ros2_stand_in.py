"""A stand-in for rclpy, whose messages are those of rosbags and pass through their CDR encoding on the way."""

from __future__ import annotations

import sys
import threading
import typing
from types import ModuleType

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
USED = {
    "sensor_msgs.msg": ("JointState", "Imu", "Image", "CameraInfo"),
    "std_msgs.msg": ("Float64MultiArray", "MultiArrayDimension"),
}
SIMPLE = {"int": 0, "float": 0.0, "string": "", "bool": False}


def empty(typename: str):
    """A message of zeros, as the classes of ROS 2 make them."""
    kind = STORE.types[typename]
    fields = {}
    for name, (node, detail) in STORE.fielddefs[typename][1]:
        fields[name] = _empty_field(int(node), detail)
    return kind(**fields)


def _empty_field(node, detail):
    if node == 1:  # one of the basic types: (name, limit)
        return SIMPLE.get(detail[0].rstrip("0123456789").removeprefix("u"), 0)
    if node == 2:
        return empty(detail)
    (inner, what), count = detail
    if inner == 1 and what[0] != "string":
        return np.zeros(count, np.dtype(what[0] if what[0] != "bool" else "bool"))
    return [_empty_field(inner, what) for _ in range(count)]


def over_the_wire(message):
    """The message as another process gets it; refused where it does not keep its definition."""
    typename = message.__msgtype__
    for name, (node, detail) in STORE.fielddefs[typename][1]:
        if int(node) < 3 or not isinstance(values := getattr(message, name), list):
            continue
        inner, what = detail[0]
        if int(inner) == 1 and what[0] != "string":  # rclpy takes lists of numbers, rosbags arrays
            setattr(message, name, np.array(values, dtype=what[0]))
    return STORE.deserialize_cdr(STORE.serialize_cdr(message, typename), typename)


class Graph:
    """All nodes of a test: who subscribes, who publishes, what was sent."""

    def __init__(self):
        self.callbacks: dict[str, list] = {}
        self.publishers: dict[str, int] = {}
        self.listeners: dict[str, int] = {}
        self.sent: dict[str, list] = {}
        self.running = False
        self.on_subscription = lambda topic: None

    def send(self, topic, message):
        received = over_the_wire(message)
        self.sent.setdefault(topic, []).append(received)
        for callback in self.callbacks.get(topic, []):
            callback(received)


class Node:
    def __init__(self, graph):
        self.graph, self.destroyed = graph, False

    def create_subscription(self, kind, topic, callback, qos):
        assert qos == "sensor data"
        self.graph.callbacks.setdefault(topic, []).append(callback)
        self.graph.on_subscription(topic)

    def create_publisher(self, kind, topic, depth):
        self.graph.publishers[topic] = self.graph.publishers.get(topic, 0) + 1
        made = type("Publisher", (), {})()
        made.publish = lambda message: self.graph.send(topic, message)
        return made

    def count_publishers(self, topic):
        return self.graph.publishers.get(topic, 0)

    def count_subscribers(self, topic):
        return self.graph.listeners.get(topic, 0)

    def destroy_node(self):
        self.destroyed = True


class Executor:
    def __init__(self):
        self.ended = threading.Event()

    def add_node(self, node):
        pass

    def spin(self):
        self.ended.wait()

    def shutdown(self):
        self.ended.set()


def install(monkeypatch) -> Graph:
    """Put the stand-in where `import rclpy` finds it."""
    graph = Graph()

    def module(name, **content):
        made = ModuleType(name)
        made.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, made)

    def set_running(value):
        graph.running = value

    module(
        "rclpy",
        ok=lambda: graph.running,
        init=lambda: set_running(True),
        shutdown=lambda: set_running(False),
        create_node=lambda name: Node(graph),
    )
    module("rclpy.executors", SingleThreadedExecutor=Executor)
    module("rclpy.qos", qos_profile_sensor_data="sensor data")
    for name, kinds in USED.items():
        module(name, **{kind: _maker(f"{name.split('.')[0]}/msg/{kind}") for kind in kinds})
    return graph


def _maker(typename: str) -> typing.Callable:
    def make(**fields):
        message = empty(typename)
        for name, value in fields.items():
            setattr(message, name, value)
        return message

    return make
