"""How an estimate of the tilt follows from rates and accelerations."""

from typing import Protocol

import torch
from torch import Tensor

from zfall.rotations import from_rotation_vector, roll_and_pitch, rotate


class TiltLaw(Protocol):
    """What a filter of the tilt keeps of each axis, ``(*B, axes, 2)``, and how it goes on.

    The second column is the gyro's bias [rad/s].
    """

    axes: int

    def begin(self, up: Tensor) -> Tensor:
        """The state of a robot that was just switched on, in which ``up`` ``(*B, 3)`` is up."""

    def after(self, state: Tensor, rate: Tensor, acceleration: Tensor, matrix: Tensor) -> Tensor:
        """The state a control step later.

        Args:
            state: ``(*B, axes, 2)``.
            rate: the gyro's in between ``(*B, axes)`` [rad/s].
            acceleration: the accelerometer's at its end ``(*B, 3)`` [m/s2].
            matrix: ``steady_update`` of a filter of one axis: state angle and bias, input rate,
                measurement angle.
        """

    def tilt(self, state: Tensor) -> Tensor:
        """Roll and pitch ``(*B, 2)`` [rad]."""


class PerAxis:
    """Roll and pitch, each by itself: of second order in the tilt, wrong near 90 degrees."""

    axes = 2

    def begin(self, up: Tensor) -> Tensor:
        angles = roll_and_pitch(up)
        return torch.stack([angles, torch.zeros_like(angles)], -1)

    def after(self, state: Tensor, rate: Tensor, acceleration: Tensor, matrix: Tensor) -> Tensor:
        angle = roll_and_pitch(acceleration)
        # Of the angles that mean the same, the one next to the estimate.
        turns = torch.round((angle - state[..., 0]) / (2.0 * torch.pi))
        angle = angle - 2.0 * torch.pi * turns
        return torch.stack([*state.unbind(-1), rate, angle], -1) @ matrix

    def tilt(self, state: Tensor) -> Tensor:
        return state[..., 0].clone()


class OnSphere:
    """The direction of up in axes of the body, a unit vector: right in any posture."""

    axes = 3

    def begin(self, up: Tensor) -> Tensor:
        up = torch.nn.functional.normalize(up, dim=-1)
        return torch.stack([up, torch.zeros_like(up)], -1)

    def after(self, state: Tensor, rate: Tensor, acceleration: Tensor, matrix: Tensor) -> Tensor:
        up, bias = state.unbind(-1)
        dt = matrix[2, 0] / matrix[0, 0]
        angle_gain, bias_gain = matrix[3]
        # A vector that rests in the world turns the other way in axes of the body.
        up = rotate(from_rotation_vector(-dt * (rate - bias)), up)
        # By what the body would have to turn for the estimate to be what is measured.
        axis = torch.linalg.cross(acceleration, up)
        sine, cosine = axis.norm(dim=-1, keepdim=True), (acceleration * up).sum(-1, keepdim=True)
        error = axis * (torch.atan2(sine, cosine) / sine.clamp_min(1e-9))
        up = rotate(from_rotation_vector(-angle_gain * error), up)
        up = torch.nn.functional.normalize(up, dim=-1)  # against roundings
        return torch.stack([up, bias + bias_gain * error], -1)

    def tilt(self, state: Tensor) -> Tensor:
        return roll_and_pitch(state[..., 0])
