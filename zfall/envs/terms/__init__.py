"""Terms of rewards and terminations: pure functions of a step.

A term takes the TensorDicts before and after the step, then keyword parameters. It has no weight,
no memory and no env; one that names a parameter ``robot`` is given the env's ``Robot``.
"""

import inspect
from collections.abc import Callable
from functools import partial

from torch import Tensor

from zfall.envs.robots import Robot


def bind(term: Callable[..., Tensor], robot: Robot) -> Callable[..., Tensor]:
    """The term with its ``robot``, if it asks for one."""
    if isinstance(term, partial):  # hydra's own kind costs half a millisecond a call
        term = partial(term.func, *term.args, **term.keywords)
    if "robot" not in inspect.signature(term).parameters:
        return term
    return partial(term, robot=robot)
