"""What an estimator begins with."""

import torch
from tensordict import TensorDictBase
from torch import Tensor


def first_estimate(tensordict: TensorDictBase, reset: TensorDictBase, key: str) -> Tensor:
    """The estimate at the begin of an episode ``(N, ...)``: the truth, unless a start gives one.

    A start in the midst of a motion writes ``("start_measured", key)``, what an estimator that saw
    the begin of it would have by now; NaN in the worlds for which it knows none.

    Args:
        tensordict: first argument of ``_reset``.
        reset: second one.
        key: the quantity.
    """
    given = tensordict.get(("start_measured", key), None)
    return reset[key] if given is None else torch.where(given.isnan(), reset[key], given)
