"""Roll and pitch from the accelerometer and the gyro."""

from collections.abc import Sequence
from typing import Annotated, ClassVar

import numpy as np
import torch
from filterpy.kalman import KalmanFilter
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.on_robot import Known, OnRobot, at_begin, seen
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.estimation.first import first_estimate
from zfall.envs.transforms.estimation.steady import steady_update
from zfall.envs.transforms.estimation.tilt_laws import OnSphere, PerAxis, TiltLaw
from zfall.envs.transforms.observations.measured import (
    check_not_measured,
    measured_key,
    read_measured,
)
from zfall.envs.transforms.values import reset_rows
from zfall.rotations import from_angles, heading, roll_and_pitch, up_axis
from zfall.values import Name, Positive, Rule

_TILTED = ("projected_gravity", "base_orientation")  # what follows from the tilt
_FOLLOWING = Rule(f"hold names of {', '.join(_TILTED)}", lambda x: set(x) <= set(_TILTED))


class TiltKalmanFilter(Transform):
    """Estimates roll, pitch and the gyro's bias from the accelerometer and the gyro.

    Each axis has its own filter with the state (angle, bias), the gyro's rate as input and
    the accelerometer's angle as measurement::

        angle' = angle + control_dt (rate - bias) + noise(gyro_std control_dt)
        bias'  = bias + noise(bias_rate sqrt(control_dt))
        accelerometer's angle = angle + noise(angle_std)

    The rate is the mean of the gyro's last two values. Roll is driven by the rate about x, pitch
    by that about y, which is exact for one axis at a time and of second order in the tilt beyond
    it. While the body accelerates or falls the accelerometer does not point up: that is what
    ``angle_std`` must cover. A robot that lies and gets up needs a ``MahonyFilter``.

    Keys: reads ``base_acceleration`` [m/s2] and ``base_angular_velocity`` [rad/s] ``(N, 3)``,
    measured if they are, and the true ``projected_gravity`` ``(N, 3)``; writes ``tilt``
    ``(N, 2)``, roll and pitch against gravity [rad], its estimate ``("measured", "tilt")``,
    ``("measured", "gyro_bias")`` ``(N, 2)`` about x and y [rad/s], and what ``also`` names.

    Args:
        env: the base env.
        gyro_std: standard deviation of the gyro's noise [rad/s].
        bias_rate: of the wandering of its bias [rad/s per square root of a second].
        angle_std: standard deviation of the accelerometer's angle [rad].
        also: quantities whose measured value is to follow from the estimate, for policies that
            observe these: ``projected_gravity``, and ``base_orientation``, whose heading is the
            true one.

    Raises:
        ValueError: if a value is not positive, or the filter does not settle.

    Source: Kalman, "A new approach to linear filtering and prediction problems", J. Basic Eng.
    1960; gains by filterpy (Labbe, "Kalman and Bayesian filters in Python").
    """

    estimates = "tilt"
    law: ClassVar[TiltLaw] = PerAxis()
    matrix: Tensor
    state: Tensor
    rate: Tensor

    measured = ("base_acceleration", "base_angular_velocity")  # sensing must come before it

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        gyro_std: Positive = 0.02,
        bias_rate: Positive = 0.002,
        angle_std: Positive = 0.2,
        also: Annotated[Sequence[Name], _FOLLOWING] = (),
    ):
        follow = [measured_key(key) for key in also]
        super().__init__(
            in_keys=["base_acceleration", "base_angular_velocity", "projected_gravity"],
            out_keys=["tilt", ("measured", "tilt"), ("measured", "gyro_bias"), *follow],
        )
        self.also = tuple(also)
        needs_env(self, env, "a memory of each world")
        values = {"gyro_std": gyro_std, "bias_rate": bias_rate, "angle_std": angle_std}
        for name, value in values.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}.")
        dt = env.control_dt
        self.kalman = KalmanFilter(dim_x=2, dim_z=1, dim_u=1)
        self.kalman.F = np.array([[1.0, -dt], [0.0, 1.0]])
        self.kalman.B = np.array([[dt], [0.0]])
        self.kalman.H = np.array([[1.0, 0.0]])
        self.kalman.Q = np.diag([(gyro_std * dt) ** 2, bias_rate**2 * dt])
        self.kalman.R = np.array([[angle_std**2]])
        self.register_buffer("matrix", steady_update(self.kalman))
        # What the law keeps, and the gyro's last rates.
        self.register_buffer("state", torch.zeros(env.num_envs, self.law.axes, 2))
        self.register_buffer("rate", torch.zeros(env.num_envs, self.law.axes))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        rate = self._rate(next_tensordict)
        ahead = read_measured(next_tensordict, "base_acceleration")
        self.state = self.law.after(self.state, (self.rate + rate) / 2.0, ahead, self.matrix)
        self.rate = rate.clone()
        return self._write(next_tensordict)

    def _rate(self, tensordict: TensorDictBase) -> Tensor:
        return read_measured(tensordict, "base_angular_velocity")[..., : self.law.axes]

    def _write(self, tensordict: TensorDictBase) -> TensorDictBase:
        tensordict["tilt"] = roll_and_pitch(-tensordict["projected_gravity"])
        angles = tensordict["measured", "tilt"] = self.law.tilt(self.state)
        tensordict["measured", "gyro_bias"] = self.state[..., :2, 1].clone()
        if self.also:
            ahead = heading(tensordict["base_orientation"])
            estimate = from_angles(torch.cat([angles, ahead], -1))
            values = {"base_orientation": estimate, "projected_gravity": -up_axis(estimate)}
            for key in self.also:
                tensordict["measured", key] = values[key]
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)[:, None]
        start = self.law.begin(-first_estimate(tensordict, tensordict_reset, "projected_gravity"))
        rate = self._rate(tensordict_reset)
        self.state = torch.where(rows[..., None], start, self.state)
        self.rate = torch.where(rows, rate, self.rate)
        return self._write(tensordict_reset)

    def on_robot(self) -> OnRobot:
        """The same on a robot, which begins with the accelerometer's angles and no bias.

        Its heading is not known: ``base_orientation`` is not among what it gives.
        """
        return _TiltOnRobot(
            self.law, self.matrix, [key for key in self.also if key != "base_orientation"]
        )

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.out_keys:
            check_not_measured(observation_spec, "TiltKalmanFilter", key)
            follows = isinstance(key, tuple) and key[1] in self.also
            shape = observation_spec[key[1]].shape if follows else (*self.rate.shape[:-1], 2)
            observation_spec[key] = Unbounded(shape)
        return observation_spec


class MahonyFilter(TiltKalmanFilter):
    """Estimates where up is, and the gyro's bias about all axes, in any posture.

    Up is a unit vector in axes of the body. The gyro turns it, exactly for a constant rate; the
    accelerometer pulls it towards its own direction, and the bias with it. The gains are those of
    ``TiltKalmanFilter``, which it equals for small angles. Roll and pitch are of the estimated
    vector. A robot that lies on its belly or rolls over does not spoil it: the other's angles jump
    there, its bias drifts, and a roll of more than half a turn is never brought back.

    Keys and arguments are those of ``TiltKalmanFilter``.

    Source: Mahony, Hamel, Pflimlin, "Nonlinear complementary filters on the special orthogonal
    group", IEEE Trans. Automatic Control 2008 (its explicit form, with the accelerometer alone).
    """

    law = OnSphere()


class _TiltOnRobot(OnRobot):
    def __init__(self, law: TiltLaw, matrix: Tensor, also: Sequence[str]):
        axes = law.axes
        states = {"tilt_filter": torch.zeros(1, axes, 2), "last_rate": torch.zeros(1, axes)}
        reads = ["base_acceleration", "base_angular_velocity"]
        super().__init__(reads, ["tilt", "gyro_bias", *also], states)
        self.law = law
        self.register_buffer("matrix", matrix.clone())

    def observe(self, known: Known) -> None:
        rate = seen(known, "base_angular_velocity")[..., : self.law.axes]
        ahead = seen(known, "base_acceleration")
        state, last = known["state", "tilt_filter"], known["state", "last_rate"]
        after = self.law.after(state, (last + rate) / 2.0, ahead, self.get_buffer("matrix"))
        state = at_begin(known, self.law.begin(ahead), after)
        known["next", "tilt_filter"], known["next", "last_rate"] = state, rate
        tilt, bias = self.law.tilt(state), state[..., :2, 1]
        known["measured", "tilt"], known["measured", "gyro_bias"] = tilt, bias
        level = torch.cat([tilt, torch.zeros_like(tilt[..., :1])], -1)
        if "projected_gravity" in self.writes:
            known["measured", "projected_gravity"] = -up_axis(from_angles(level))
