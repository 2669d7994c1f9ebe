"""Loops over worlds at the speed of C."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
T = TypeVar("T")


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """The function, compiled by numba when it is first called, without Python's lock.

    What was compiled is kept on disk for the next process, where there is a folder to keep it in.
    """
    try:
        return numba.njit(cache=True, nogil=True)(function)
    except RuntimeError:  # neither the package's folder nor that of the user's caches
        return numba.njit(nogil=True)(function)
