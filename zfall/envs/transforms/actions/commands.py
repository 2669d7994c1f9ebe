"""What the servos are told at each physics step."""

from tensordict import TensorDictBase
from torch import Tensor


def read_commands(tensordict: TensorDictBase, substeps: int) -> Tensor:
    """Commands of the coming S physics steps ``(N, S, J)`` [rad].

    ``control`` if an earlier transform wrote it, else ``target`` ``(N, J)``, held.
    """
    control = tensordict.get("control", None)
    if control is None:
        control = tensordict["target"][:, None].expand(-1, substeps, -1)
    return control
