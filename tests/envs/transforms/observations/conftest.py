"""Measurements of given values, without the physics."""

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Transform


@pytest.fixture
def measure() -> Callable[..., torch.Tensor]:
    """Resets a transform (``rows`` ``(N, 1)``, all if not given) or steps it once.

    Gives it values by name; returns what it measures of the first, and checks that the true values
    are left alone.
    """

    def run(
        transform: Transform,
        *,
        reset: bool = False,
        rows: torch.Tensor | None = None,
        **values: torch.Tensor,
    ) -> torch.Tensor:
        num = len(next(iter(values.values())))
        td = TensorDict({key: value.clone() for key, value in values.items()}, [num])
        if reset:
            source = TensorDict({} if rows is None else {"_reset": rows}, [num])
            td = transform._reset(source, td)
        else:
            td = transform._call(td)
        for key, value in values.items():
            assert torch.equal(td[key], value)
        return td["measured", next(iter(values))]

    return run
