"""What the robot's own computer works out from its sensors.

The Kalman filters run with the gain that they settle at: filterpy computes it once, by running the
filter until it does, and all worlds are then updated by one matrix product per step. After a reset
an estimate is the true value; that of the gyro's bias is 0, as of a robot just switched on: with a
bias of 0.02 rad/s the tilt is off by up to 0.04 rad in the first ten seconds.
"""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
import torch
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import KalmanFilter
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.observations.measured import measured_key, read_measured
from zfall.envs.transforms.values import reset_rows
from zfall.rotations import from_angles, heading, roll_and_pitch, up_axis
from zfall.values import Name, Positive, Rule

_TILTED = ("projected_gravity", "base_orientation")  # what follows from the tilt
_FOLLOWING = Rule(f"hold names of {', '.join(_TILTED)}", lambda x: set(x) <= set(_TILTED))


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
    ``angle_std`` must cover.

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
        # Angle and bias of both axes, and the gyro's last rates.
        self.register_buffer("state", torch.zeros(env.num_envs, 2, 2))
        self.register_buffer("rate", torch.zeros(env.num_envs, 2))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        rate = read_measured(next_tensordict, "base_angular_velocity")[..., :2]
        angle = roll_and_pitch(read_measured(next_tensordict, "base_acceleration"))
        # Of the angles that mean the same, the one next to the estimate.
        turns = torch.round((angle - self.state[..., 0]) / (2.0 * torch.pi))
        angle = angle - 2.0 * torch.pi * turns
        known = torch.stack([*self.state.unbind(-1), (self.rate + rate) / 2.0, angle], -1)
        self.state, self.rate = known @ self.matrix, rate.clone()
        return self._write(next_tensordict)

    def _write(self, tensordict: TensorDictBase) -> TensorDictBase:
        tensordict["tilt"] = roll_and_pitch(-tensordict["projected_gravity"])
        tensordict["measured", "tilt"] = self.state[..., 0].clone()
        tensordict["measured", "gyro_bias"] = self.state[..., 1].clone()
        if self.also:
            ahead = heading(tensordict["base_orientation"])
            estimate = from_angles(torch.cat([self.state[..., 0], ahead], -1))
            values = {"base_orientation": estimate, "projected_gravity": -up_axis(estimate)}
            for key in self.also:
                tensordict["measured", key] = values[key]
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)[:, None]
        true = roll_and_pitch(-tensordict_reset["projected_gravity"])
        start = torch.stack([true, torch.zeros_like(true)], -1)
        rate = read_measured(tensordict_reset, "base_angular_velocity")[..., :2]
        self.state = torch.where(rows[..., None], start, self.state)
        self.rate = torch.where(rows, rate, self.rate)
        return self._write(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.out_keys:
            _check_not_measured(observation_spec, "TiltKalmanFilter", key)
            follows = isinstance(key, tuple) and key[1] in self.also
            shape = observation_spec[key[1]].shape if follows else self.rate.shape
            observation_spec[key] = Unbounded(shape)
        return observation_spec


class JointVelocityKalmanFilter(Transform):
    """Estimates joint velocities from the encoders' angles, for joints accelerated at random.

    Each joint has a filter with the state (angle, velocity); its acceleration is a random number
    that holds for a control step. It lags less than a difference of the same smoothness.

    Keys: reads ``joint_position`` ``(N, J)`` [rad], measured if it is; writes
    ``("measured", "joint_velocity")`` ``(N, J)`` [rad/s].

    Args:
        env: the base env.
        position_std: standard deviation of the encoders' error [rad].
        acceleration_std: standard deviation of the joints' accelerations [rad/s2].

    Raises:
        ValueError: if a value is not positive, or the filter does not settle; when the specs are
            built, if an earlier transform has measured ``joint_velocity``.

    Source: Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and
    Navigation", Wiley 2001, section 6.3.2 (discrete white noise acceleration); gains by filterpy.
    """

    estimates = "joint_velocity"
    matrix: Tensor
    state: Tensor

    measured = True  # sensing must come before it

    def __init__(
        self, env: HumanoidEnv, *, position_std: Positive = 0.01, acceleration_std: Positive = 10.0
    ):
        super().__init__(in_keys=["joint_position"], out_keys=[("measured", "joint_velocity")])
        needs_env(self, env, "a memory of each world")
        values = {"position_std": position_std, "acceleration_std": acceleration_std}
        for name, value in values.items():
            if not value > 0:
                raise ValueError(f"{name} must be positive, got {value}.")
        self.kalman = KalmanFilter(dim_x=2, dim_z=1)
        self.kalman.F = np.array([[1.0, env.control_dt], [0.0, 1.0]])
        self.kalman.H = np.array([[1.0, 0.0]])
        self.kalman.Q = Q_discrete_white_noise(2, dt=env.control_dt, var=acceleration_std**2)
        self.kalman.R = np.array([[position_std**2]])
        self.register_buffer("matrix", steady_update(self.kalman))
        self.register_buffer("state", torch.zeros(env.num_envs, len(env.stand_position), 2))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        angle = read_measured(next_tensordict, "joint_position")
        self.state = torch.cat([self.state, angle[..., None]], -1) @ self.matrix
        return next_tensordict.set(("measured", "joint_velocity"), self.state[..., 1].clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        angle = read_measured(tensordict_reset, "joint_position")
        start = torch.stack([angle, tensordict_reset["joint_velocity"]], -1)
        self.state = torch.where(reset_rows(tensordict, self)[:, None, None], start, self.state)
        return tensordict_reset.set(("measured", "joint_velocity"), self.state[..., 1].clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        return _declare_velocity(observation_spec, "JointVelocityKalmanFilter")


class NumericalVelocity(Transform):
    """Takes joint velocities from the encoders' angles by their change over a control step.

    ``velocity = (joint_position - the one before) / control_dt``: the mean velocity of the step,
    half a step old.

    Keys: reads ``joint_position`` ``(N, J)`` [rad], measured if it is; writes
    ``("measured", "joint_velocity")`` ``(N, J)`` [rad/s].

    Args:
        env: the base env.

    Raises:
        ValueError: when the specs are built, if an earlier transform has measured
            ``joint_velocity``.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV.
    """

    estimates = "joint_velocity"
    previous: Tensor

    measured = True  # sensing must come before it

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys=["joint_position"], out_keys=[("measured", "joint_velocity")])
        needs_env(self, env, "a memory of each world")
        self.control_dt = env.control_dt
        self.register_buffer("previous", env.stand_position.repeat(env.num_envs, 1))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        angle = read_measured(next_tensordict, "joint_position")
        velocity = (angle - self.previous) / self.control_dt
        self.previous = angle.clone()
        return next_tensordict.set(("measured", "joint_velocity"), velocity)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        angle = read_measured(tensordict_reset, "joint_position")
        self.previous = torch.where(reset_rows(tensordict, self)[:, None], angle, self.previous)
        velocity = tensordict_reset["joint_velocity"].clone()
        return tensordict_reset.set(("measured", "joint_velocity"), velocity)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        return _declare_velocity(observation_spec, "NumericalVelocity")


def _check_not_measured(spec: Composite, name: str, key: tuple[str, ...] | str) -> None:
    if key in spec.keys(True):
        raise ValueError(
            f"{name} must stand before other transforms that measure the same, but {key} is "
            "already there; noise on an estimate stands after it."
        )


def _declare_velocity(spec: Composite, name: str) -> Composite:
    key = measured_key("joint_velocity")
    _check_not_measured(spec, name, key)
    spec[key] = Unbounded(spec["joint_velocity"].shape)
    return spec
