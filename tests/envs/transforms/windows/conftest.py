"""Motions of given values, without the physics."""

from collections.abc import Callable

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Transform


@pytest.fixture
def play() -> Callable[..., list[TensorDict]]:
    """Sends states through a transform: a reset to the first, then a step to each other one.

    ``frames`` are values by key, ``resets`` the worlds that begin anew at a frame ``{k: rows}``.
    Returns the TensorDict after each of them.
    """

    def run(
        transform: Transform,
        frames: list[dict[str, torch.Tensor]],
        resets: dict[int, torch.Tensor] | None = None,
    ) -> list[TensorDict]:
        out: list[TensorDict] = []
        for k, values in enumerate(frames):
            num = len(next(iter(values.values())))
            td = TensorDict({key: value.clone() for key, value in values.items()}, [num])
            if k == 0:
                out.append(transform._reset(TensorDict(batch_size=[num]), td))
                continue
            td = transform._step(out[-1], td)
            if resets and k in resets:  # those rows step into something, and start again from here
                rows = resets[k]
                again = TensorDict({key: v.clone() for key, v in values.items()}, [num])
                again = transform._reset(TensorDict({"_reset": rows[:, None]}, [num]), again)
                td = torch.where(rows, again, td)
            out.append(td)
        return out

    return run


@pytest.fixture
def looking() -> Callable[[torch.Tensor], torch.Tensor]:
    """Orientations ``(N, 4)`` of level bodies with given headings ``(N,)``."""

    def build(heading: torch.Tensor) -> torch.Tensor:
        zero = torch.zeros_like(heading)
        return torch.stack([(heading / 2).cos(), zero, zero, (heading / 2).sin()], -1)

    return build
