"""Networks as other frameworks write them, as ONNX, built operator by operator."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper, save_model
from torch import nn

# An operator, what it reads and what it writes, and its attributes.
Node = tuple[str, list[str], list[str], dict[str, Any]]


def write_graph(
    path: Path,
    nodes: Sequence[Node],
    weights: dict[str, NDArray[Any]],
    inputs: dict[str, Sequence[int | str]],
    outputs: dict[str, Sequence[int | str]],
    kind: int = TensorProto.FLOAT,
) -> Path:
    """Writes a graph of operators."""
    values = [
        [helper.make_tensor_value_info(name, kind, list(shape)) for name, shape in side.items()]
        for side in (inputs, outputs)
    ]
    made = [helper.make_node(op, reads, writes, **how) for op, reads, writes, how in nodes]
    held = [numpy_helper.from_array(value, name) for name, value in weights.items()]
    graph = helper.make_graph(made, "policy", *values, held)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)])
    model.ir_version = 10
    save_model(model, str(path))
    return path


def write_mlp(path: Path, mlp: nn.Sequential, batch: int | str = 1) -> Path:
    """``obs`` ``(batch, D)`` -> ``actions``: linear layers and ELUs, as rsl_rl's ``MLP``."""
    nodes: list[Node] = []
    weights, last = {}, "obs"
    linear = [layer for layer in mlp if isinstance(layer, nn.Linear)]
    for number, layer in enumerate(mlp):
        out = "actions" if number == len(mlp) - 1 else f"x{number}"
        if isinstance(layer, nn.Linear):
            weights[f"w{number}"] = layer.weight.detach().numpy()
            weights[f"b{number}"] = layer.bias.detach().numpy()
            reads = [last, f"w{number}", f"b{number}"]
            nodes.append(("Gemm", reads, [out], {"transB": 1}))
        else:
            nodes.append(("Elu", [last], [out], {}))
        last = out
    sizes = linear[0].in_features, linear[-1].out_features
    return write_graph(
        path, nodes, weights, {"obs": (batch, sizes[0])}, {"actions": (batch, sizes[1])}
    )


def write_linear(
    path: Path, matrix: NDArray[np.float32], batch: int | str = 1, **kwargs: Any
) -> Path:
    """``obs`` ``(batch, D)`` -> ``actions = obs matrix`` ``(batch, A)``."""
    size, joints = matrix.shape
    nodes: list[Node] = [("MatMul", ["obs", "w"], ["actions"], {})]
    return write_graph(
        path, nodes, {"w": matrix}, {"obs": (batch, size)}, {"actions": (batch, joints)}, **kwargs
    )
