"""What the servos are commanded at each physics step."""

import torch
from tensordict import TensorDictBase
from torch import Tensor


def read_commands(tensordict: TensorDictBase, substeps: int) -> Tensor:
    """Commands of the coming S physics steps ``(N, S, J)`` [rad].

    ``control`` if an earlier transform wrote it, else ``target`` ``(N, J)``, in all steps.
    """
    control = tensordict.get("control", None)
    if control is None:
        control = tensordict["target"][:, None].expand(-1, substeps, -1)
    return control


def targets_before(tensordict: TensorDictBase, otherwise: Tensor) -> Tensor:
    """What the servos followed until an episode begins ``(N, J)`` [rad].

    ``("start", "target")``, if a start has written it, where it is not NaN; else ``otherwise``
    ``(N, J)``. Reads the first argument of a transform's ``_reset``.
    """
    given = tensordict.get(("start", "target"), None)
    return otherwise if given is None else torch.where(given.isnan(), otherwise, given)
