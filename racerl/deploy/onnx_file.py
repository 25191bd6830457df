"""A driver as an ONNX model: `observation` (N, O) and `last_drive_ref` (N, 1) in, `delta_ref` and `drive_ref` out.

That of a recurrent policy also takes `memory` (N, U), nought at first, and gives `next_memory`.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from racerl.deploy.driver import Array, Cell, Driver

OPSET, IR_VERSION = 17, 8  # of 2022, which the runtimes of today's small computers read
INPUTS, OUTPUTS = ("observation", "last_drive_ref"), ("delta_ref", "drive_ref")
MEMORY, NEXT_MEMORY = "memory", "next_memory"


def onnx_bytes(driver: Driver, card: Mapping[str, Any]) -> bytes:
    """Return the model, checked, with the card as JSON in its metadata."""
    graph = _Graph()
    value = graph.add("Div", INPUTS[0], graph.constant("maxima", driver.maxima))
    value = graph.clip(value, -driver.limit, driver.limit)
    for number, (weight, bias) in enumerate(driver.layers):
        value = graph.layer(str(number), value, weight, bias)
        if number < len(driver.layers) - 1:
            value = graph.add("LeakyRelu", value, alpha=driver.slope)
        if driver.cell and not number:
            value = graph.add("Concat", value, _remembered(graph, value, driver.cell), axis=1)
    value = graph.clip(value, -1.0, 1.0)
    columns = [graph.constant(f"column_{i}", np.array([i], np.int64)) for i in range(2)]
    steering, drive = (graph.add("Gather", value, column, axis=1) for column in columns)
    graph.add("Mul", steering, graph.number("steering_max", driver.steering_max), out=OUTPUTS[0])
    drive = graph.add("Mul", drive, graph.number("gain", driver.gain))
    # an input that a policy does not need stays an input, so that all policies are asked alike
    last = graph.add("Mul", INPUTS[1], graph.number("of_last", float(driver.middle is None)))
    drive = graph.add("Add", graph.add("Add", drive, last), graph.number("middle", driver.middle or 0.0))
    graph.clip(drive, driver.drive_min, driver.drive_max, out=OUTPUTS[1])

    sizes = {INPUTS[0]: len(driver.sees), INPUTS[1]: 1, OUTPUTS[0]: 1, OUTPUTS[1]: 1}
    sizes |= {MEMORY: driver.units, NEXT_MEMORY: driver.units}
    ends = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, ["cars", n]) for name, n in sizes.items()}
    inputs, outputs = ([ends[name] for name in names] for names in interface(driver))
    made = helper.make_graph(graph.nodes, "racerl", inputs, outputs, graph.constants)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    model.producer_name = "racerl"
    helper.set_model_props(model, {"racerl": json.dumps(card, ensure_ascii=False)})
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


def interface(driver: Driver) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of what goes in and of what comes out."""
    return ((*INPUTS, MEMORY), (*OUTPUTS, NEXT_MEMORY)) if driver.cell else (INPUTS, OUTPUTS)


def _remembered(graph: "_Graph", value: str, cell: Cell) -> str:
    """Add a gated recurrent unit; return what it remembers then."""
    told = graph.layer("told", value, cell.weight, cell.bias)
    known = graph.layer("known", MEMORY, cell.memory_weight, cell.memory_bias)
    places = graph.constant("thirds", np.full(3, cell.units, np.int64))
    told_parts, known_parts = (graph.split(each, places) for each in (told, known))
    reset, update = (graph.add("Sigmoid", graph.add("Add", told_parts[i], known_parts[i])) for i in range(2))
    new = graph.add("Tanh", graph.add("Add", told_parts[2], graph.add("Mul", reset, known_parts[2])))
    kept = graph.add("Mul", update, graph.add("Sub", MEMORY, new))
    return graph.add("Add", new, kept, out=NEXT_MEMORY)


class _Graph:
    """Nodes and constants, with names for what is between them."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, kind: str, *inputs: str, out: str = "", **attributes: Any) -> str:
        name = out or f"value_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], name=f"{kind}_{len(self.nodes)}", **attributes))
        return name

    def layer(self, name: str, value: str, weight: Array, bias: Array) -> str:
        names = self.constant(f"weight_{name}", weight), self.constant(f"bias_{name}", bias)
        return self.add("Gemm", value, *names, transB=1)

    def split(self, value: str, places: str) -> list[str]:
        parts = [f"{value}_part_{i}" for i in range(3)]
        self.nodes.append(helper.make_node("Split", [value, places], parts, name=f"Split_{len(self.nodes)}", axis=1))
        return parts

    def clip(self, value: str, low: float, high: float, out: str = "") -> str:
        number = len(self.nodes)
        return self.add("Clip", value, self.number(f"low_{number}", low), self.number(f"high_{number}", high), out=out)

    def constant(self, name: str, value: Array | np.ndarray[Any, Any]) -> str:
        self.constants.append(numpy_helper.from_array(value, name))
        return name

    def number(self, name: str, value: float) -> str:
        return self.constant(name, np.array(value, np.float32))
