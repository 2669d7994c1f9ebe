"""All that an env depends on, saved and restored: it then goes on bit for bit."""

from collections.abc import Mapping
from typing import Any

from torch import Tensor
from torch.nn import Module, UninitializedBuffer
from torchrl.envs import TransformedEnv

State = dict[str, Any]


def env_state(env: TransformedEnv) -> State:
    """State of an env: of its base env, and of its transforms. What is in it stays as it is."""
    return {"base_env": env.base_env.state_dict(), "transform": _transform_state(env.transform)}


def load_env_state(env: TransformedEnv, state: Mapping[str, Any]) -> None:
    """Restores what ``env_state`` gave.

    Raises:
        ValueError: if it is that of another env.
    """
    if not {"base_env", "transform"} <= state.keys():
        raise ValueError(
            "an env's state must have base_env and transform, as env.state_dict() gives them, "
            f"got {', '.join(map(str, state)) or 'nothing'}."
        )
    if hasattr(env.base_env, "check_state"):  # first, so that nothing is half restored
        env.base_env.check_state(state["base_env"])
    _check_transforms(env.transform, state["transform"])
    env.base_env.load_state_dict(state["base_env"])
    env.transform.load_state_dict(state["transform"], strict=False)


def _check_transforms(transform: Module, state: Mapping[str, Any]) -> None:
    """Refuses the state of other transforms, and makes room for what the first reset makes."""
    lazy = {k: b for k, b in transform.named_buffers() if isinstance(b, UninitializedBuffer)}
    there = _transform_state(transform)
    differ = sorted(there.keys() - state.keys()) + sorted(state.keys() - there.keys() - lazy.keys())
    differ += [
        key
        for key in there.keys() & state.keys()
        if isinstance(there[key], Tensor) and there[key].shape != state[key].shape
    ]
    if differ:
        raise ValueError(
            "an env's state must be of the same transforms and as many worlds; "
            f"transform.{differ[0]} differs."
        )
    for key, buffer in lazy.items():
        if key in state:
            buffer.materialize(state[key].shape, dtype=state[key].dtype)


def _transform_state(transform: Module) -> State:
    """Copies of what transforms remember, as far as it has been made yet."""
    state = transform.state_dict(keep_vars=True).items()  # which leaves alone what is not
    return {
        key: value.detach().clone() if isinstance(value, Tensor) else value
        for key, value in state
        if not isinstance(value, UninitializedBuffer)
    }
