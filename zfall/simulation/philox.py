"""Random numbers by a counter: any number of any stream without the ones before it.

Philox4x64-10 turns a counter and a key into 256 random bits. Here the key is of a stream, and the
counter holds the world and how far it has come, so worlds need no generator each. NumPy's Philox
draws for one stream alone; torch's functional one does not run on a CPU.

Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
512 worlds x 60 normal numbers take 0.30 ms on one core, 60 uniform ones 0.09 ms.
"""

import math

import numpy as np
from numpy.typing import NDArray

from zfall.simulation.compiled import compiled

Worlds = NDArray[np.int64]

_MULTIPLIERS = np.uint64(0xD2E7470EE14C6C93), np.uint64(0xCA5A826395121157)
_WEYL = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBB67AE8584CAA73B)
_HALF, _LOW = np.uint64(32), np.uint64(0xFFFFFFFF)
_ZERO, _ONE = np.uint64(0), np.uint64(1)
_BITS_OFF = np.uint64(8)  # of 32: a float32 has 24
_UNIT, _UNIT_24, _HALF_UNIT = np.float32(2.0**-32), np.float32(2.0**-24), np.float32(2.0**-33)
_MINUS_TWO, _CIRCLE = np.float32(-2.0), np.float32(2.0 * math.pi)


@compiled
def _high(a: np.uint64, b: np.uint64) -> np.uint64:
    """The upper half of a product of 128 bits."""
    middle = (a >> _HALF) * (b & _LOW) + ((a & _LOW) * (b & _LOW) >> _HALF)
    other = (a & _LOW) * (b >> _HALF) + (middle & _LOW)
    return (a >> _HALF) * (b >> _HALF) + (middle >> _HALF) + (other >> _HALF)


@compiled
def philox(
    a: np.uint64, b: np.uint64, c: np.uint64, d: np.uint64, key: np.uint64, second: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Four random words of the counter ``(a, b, c, d)`` under a key of two words."""
    for _ in range(10):
        a, b, c, d = (
            _high(_MULTIPLIERS[1], c) ^ b ^ key,
            _MULTIPLIERS[1] * c,
            _high(_MULTIPLIERS[0], a) ^ d ^ second,
            _MULTIPLIERS[0] * a,
        )
        key, second = key + _WEYL[0], second + _WEYL[1]
    return a, b, c, d


@compiled
def fill_uniform(
    out: NDArray[np.float32],
    rows: NDArray[np.bool_],
    worlds: Worlds,
    at: Worlds,
    seed: np.uint64,
    purpose: np.uint64,
) -> None:
    """Uniform numbers in [0, 1), multiples of 2^-24.

    Args:
        out: filled in ``rows`` ``(N, K)``.
        rows: which worlds draw ``(N,)``.
        worlds: which each is ``(N,)``.
        at: next counter of each ``(N,)``; moved on in ``rows``.
        seed, purpose: of the stream.
    """
    for i in range(len(out)):
        if not rows[i]:
            continue
        count, world, k = np.uint64(at[i]), np.uint64(worlds[i]), 0
        while k < out.shape[1]:
            for word in philox(count, _ZERO, world, _ZERO, seed, purpose):
                for half in (word >> _HALF, word & _LOW):
                    if k < out.shape[1]:
                        out[i, k] = np.float32(half >> _BITS_OFF) * _UNIT_24
                    k += 1
            count += _ONE
        at[i] = count


@compiled
def fill_normal(
    out: NDArray[np.float32],
    rows: NDArray[np.bool_],
    worlds: Worlds,
    at: Worlds,
    seed: np.uint64,
    purpose: np.uint64,
) -> None:
    """Numbers from N(0, 1) by the method of Box and Muller, arguments as in ``fill_uniform``."""
    for i in range(len(out)):
        if not rows[i]:
            continue
        count, world, k = np.uint64(at[i]), np.uint64(worlds[i]), 0
        while k < out.shape[1]:
            for word in philox(count, _ZERO, world, _ZERO, seed, purpose):
                if k < out.shape[1]:  # of a uniform number in (0, 1], so that it has a logarithm
                    share = np.float32(word >> _HALF) * _UNIT + _HALF_UNIT
                    radius = np.sqrt(_MINUS_TWO * np.log(share))
                    angle = _CIRCLE * (np.float32(word & _LOW) * _UNIT)
                    out[i, k] = radius * np.cos(angle)
                    if k + 1 < out.shape[1]:
                        out[i, k + 1] = radius * np.sin(angle)
                k += 2
            count += _ONE
        at[i] = count


@compiled
def fill_integers(
    out: NDArray[np.int64],
    rows: NDArray[np.bool_],
    worlds: Worlds,
    at: Worlds,
    seed: np.uint64,
    purpose: np.uint64,
    high: np.uint64,
) -> None:
    """Whole numbers from 0 to ``high - 1``, arguments as in ``fill_uniform``."""
    for i in range(len(out)):
        if not rows[i]:
            continue
        count, world, k = np.uint64(at[i]), np.uint64(worlds[i]), 0
        while k < out.shape[1]:
            for word in philox(count, _ZERO, world, _ZERO, seed, purpose):
                if k < out.shape[1]:
                    out[i, k] = np.int64(_high(word, high))
                k += 1
            count += _ONE
        at[i] = count
