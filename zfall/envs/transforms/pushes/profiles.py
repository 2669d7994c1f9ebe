"""How the force of a push goes over its duration."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

Array = NDArray[np.floating]

_WIDTH = 3.0  # a Gaussian push begins and ends three standard deviations from its peak
_WITHIN = math.erf(_WIDTH / math.sqrt(2))


@dataclass(frozen=True)
class Profile:
    """Shape of a push.

    Args:
        given: share of the impulse given once the share u of the duration has passed; from 0 at
            u = 0 to 1 at u = 1.
        mean: mean force over the duration, as a share of the peak: ``impulse = mean x peak x
            duration``.
    """

    given: Callable[[Array], Array]
    mean: float


def _rectangular(u: Array) -> Array:
    return u


def _half_sine(u: Array) -> Array:
    return 0.5 * (1.0 - np.cos(math.pi * u))


def _gaussian(u: Array) -> Array:
    return 0.5 + 0.5 * erf(_WIDTH * (2.0 * u - 1.0) / math.sqrt(2)) / _WITHIN


def _ramp(u: Array) -> Array:
    return u * u


PROFILES = {  # of functions with names, which can be pickled
    "rectangular": Profile(_rectangular, 1.0),
    "half_sine": Profile(_half_sine, 2.0 / math.pi),
    "gaussian": Profile(_gaussian, _WITHIN * math.sqrt(2 * math.pi) / (2 * _WIDTH)),
    "ramp": Profile(_ramp, 0.5),
}
"""By name; ``half_sine`` and ``gaussian`` are bells, ``ramp`` grows to its peak and stops."""


def find_profile(name: str) -> Profile:
    """The profile of that name.

    Raises:
        ValueError: if there is none.
    """
    if name not in PROFILES:
        raise ValueError(f"profile must be one of {', '.join(PROFILES)}, got {name!r}.")
    return PROFILES[name]


def force_share(
    begin: Array, physics_dt: float, start: Array, duration: Array | float, profile: Profile
) -> Array:
    """Mean force over each physics step, as a share of the push's peak force.

    Args:
        begin: begin of each physics step ``(S,)`` [s from now].
        physics_dt: length of a physics step [s].
        start: begin of the pushes ``(*B,)`` [s from now].
        duration: their length ``(*B,)`` or one for all [s].
        profile: their shape.

    Returns:
        ``(*B, S)`` in [0, 1]. Its sum times ``physics_dt`` is ``profile.mean x duration`` once
        the push is over, whatever the rates, so that the impulse is exact.
    """
    length = np.asarray(duration)[..., None]
    edges = np.append(begin, begin[-1] + physics_dt)
    given = profile.given(((edges - start[..., None]) / length).clip(0.0, 1.0))
    return np.diff(given) * (profile.mean * length / physics_dt)
