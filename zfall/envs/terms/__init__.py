"""Terms of rewards and terminations: pure functions of a step.

A term takes the TensorDicts before and after the step, then keyword parameters. It has no weight,
no memory and no env; one that names a parameter ``robot`` is given the env's ``Robot``, one that
names ``joint_range`` the ranges of its joints.
"""

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

from torch import Tensor

from zfall.values import check_names


def bind(term: Callable[..., Tensor], **known: Any) -> Callable[..., Tensor]:
    """The term with those of ``known`` that it names as parameters and was not given.

    A term that was given another one as ``term`` has that one bound, too.

    Raises:
        ValueError: if a parameter without a default has no value then, it does not take the two
            TensorDicts, or names what the robot does not have (``zfall.values.NamesOf``).
    """
    if isinstance(term, partial):  # hydra's own kind costs half a millisecond a call
        term = partial(term.func, *term.args, **term.keywords)
    given = term.keywords if isinstance(term, partial) else {}
    if "term" in given:
        term = partial(term, term=bind(given["term"], **known))
    if "robot" in known:
        check_names(getattr(term, "func", term), given, known["robot"])
    named = inspect.signature(term).parameters.keys() & known.keys() - given.keys()
    bound = partial(term, **{name: known[name] for name in named}) if named else term
    name = getattr(getattr(term, "func", term), "__name__", type(term).__name__)
    signature = inspect.signature(bound)
    for parameter in signature.parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and parameter.default is parameter.empty:
            raise ValueError(f"{name} must be given {parameter.name}, which has no default.")
    try:
        signature.bind("td", "next_td")
    except TypeError as error:
        raise ValueError(
            f"{name} must take (td, next_td), the TensorDicts before and after the step, and what "
            f"its entry gives: {error}."
        ) from None
    return bound
