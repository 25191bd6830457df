"""A driver as an ONNX model: `observation` (N, O) and `last_drive_ref` (N, 1) in, `delta_ref` and `drive_ref` out."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from racerl.deploy.driver import Array, Driver

OPSET, IR_VERSION = 17, 8  # of 2022, which the runtimes of today's small computers read
INPUTS, OUTPUTS = ("observation", "last_drive_ref"), ("delta_ref", "drive_ref")


def onnx_bytes(driver: Driver, card: Mapping[str, Any]) -> bytes:
    """Return the model, checked, with the card as JSON in its metadata."""
    graph = _Graph()
    value = graph.add("Div", INPUTS[0], graph.constant("maxima", driver.maxima))
    value = graph.clip(value, -driver.limit, driver.limit)
    for number, (weight, bias) in enumerate(driver.layers):
        if number:
            value = graph.add("LeakyRelu", value, alpha=driver.slope)
        names = graph.constant(f"weight_{number}", weight), graph.constant(f"bias_{number}", bias)
        value = graph.add("Gemm", value, *names, transB=1)
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
    ends = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, ["cars", n]) for name, n in sizes.items()}
    inputs, outputs = [ends[name] for name in INPUTS], [ends[name] for name in OUTPUTS]
    made = helper.make_graph(graph.nodes, "racerl", inputs, outputs, graph.constants)
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    model.producer_name = "racerl"
    helper.set_model_props(model, {"racerl": json.dumps(card, ensure_ascii=False)})
    onnx.checker.check_model(model, full_check=True)
    return bytes(model.SerializeToString(deterministic=True))


class _Graph:
    """Nodes and constants, with names for what is between them."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, kind: str, *inputs: str, out: str = "", **attributes: Any) -> str:
        name = out or f"value_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], name=f"{kind}_{len(self.nodes)}", **attributes))
        return name

    def clip(self, value: str, low: float, high: float, out: str = "") -> str:
        number = len(self.nodes)
        return self.add("Clip", value, self.number(f"low_{number}", low), self.number(f"high_{number}", high), out=out)

    def constant(self, name: str, value: Array | np.ndarray[Any, Any]) -> str:
        self.constants.append(numpy_helper.from_array(value, name))
        return name

    def number(self, name: str, value: float) -> str:
        return self.constant(name, np.array(value, np.float32))
