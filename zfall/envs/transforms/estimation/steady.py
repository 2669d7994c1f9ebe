"""Kalman filters with the gain that they settle at."""

import numpy as np
import torch
from filterpy.kalman import KalmanFilter
from torch import Tensor


def steady_update(kalman: KalmanFilter) -> Tensor:
    """Runs a filter until its gain K has settled.

    Args:
        kalman: with ``F``, ``H``, ``Q``, ``R`` and, if it has an input, ``B``; its ``K`` is that
            of the settled filter afterwards.

    Returns:
        Matrix ``(states + inputs + measurements, states)`` that takes a row (state, input,
        measurement) to the next state, ``x' = (I - K H)(F x + B u) + K z``.

    Raises:
        ValueError: if the gain does not settle.
    """
    kalman.test_matrix_dimensions()
    zero = np.zeros((kalman.dim_z, 1))
    for _ in range(20_000):
        before = kalman.K
        kalman.predict()
        kalman.update(zero)
        if np.abs(kalman.K - before).max() <= 1e-12 * np.abs(kalman.K).max():
            break
    else:
        raise ValueError(
            "the standard deviations must let the filter settle; these did not in 2e4 steps."
        )
    keep = np.eye(kalman.dim_x) - kalman.K @ kalman.H
    columns = [keep @ kalman.F, kalman.K]
    if kalman.B is not None:
        columns.insert(1, keep @ kalman.B)
    return torch.from_numpy(np.concatenate(columns, 1).T.copy()).float()
