"""What a transform has drawn for each world, shown as a physical parameter.

A critic reads it there, and so does ``zfall.evaluation.draws``, which looks for what explains a
policy's failures.
"""

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded


def show_drawn(tensordict: TensorDictBase, param: str | None, value: Tensor) -> TensorDictBase:
    """Writes a value ``(N,)`` or ``(N, size)`` as ``("params", param)``; nothing if ``None``."""
    if param is not None:
        tensordict["params", param] = value if value.ndim > 1 else value[:, None]
    return tensordict


def declare_drawn(spec: Composite, param: str | None, size: int = 1) -> Composite:
    """Adds what ``show_drawn`` writes to a spec."""
    if param is not None:
        spec["params", param] = Unbounded((*spec.shape, size))
    return spec


def drawn_mirror(param: str | None) -> dict[str, tuple[float, ...]]:
    """For ``mirror_signs``: a number of the whole robot is that of its mirror image."""
    return {} if param is None else {f"params/{param}": (1.0,)}
