"""Joint velocities from the encoders' angles."""

import numpy as np
import torch
from filterpy.common import Q_discrete_white_noise
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
from zfall.envs.transforms.observations.measured import (
    check_not_measured,
    measured_key,
    read_measured,
)
from zfall.envs.transforms.values import reset_rows
from zfall.values import Positive


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
        self.state = _updated(self.state, angle, self.matrix)
        return next_tensordict.set(("measured", "joint_velocity"), self.state[..., 1].clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        angle = read_measured(tensordict_reset, "joint_position")
        speed = first_estimate(tensordict, tensordict_reset, "joint_velocity")
        start = torch.stack([angle, speed], -1)
        self.state = torch.where(reset_rows(tensordict, self)[:, None, None], start, self.state)
        return tensordict_reset.set(("measured", "joint_velocity"), self.state[..., 1].clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        return _declare_velocity(observation_spec, "JointVelocityKalmanFilter")

    def on_robot(self) -> OnRobot:
        """The same on a robot, which begins at rest."""
        return _KalmanOnRobot(self.matrix, self.state[:1])


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

    def on_robot(self) -> OnRobot:
        """The same on a robot, which begins at rest."""
        return _DifferenceOnRobot(self.previous[:1], self.control_dt)


def _declare_velocity(spec: Composite, name: str) -> Composite:
    key = measured_key("joint_velocity")
    check_not_measured(spec, name, key)
    spec[key] = Unbounded(spec["joint_velocity"].shape)
    return spec


def _updated(state: Tensor, angle: Tensor, matrix: Tensor) -> Tensor:
    return torch.cat([state, angle[..., None]], -1) @ matrix


class _KalmanOnRobot(OnRobot):
    def __init__(self, matrix: Tensor, state: Tensor):
        states = {"joint_velocity_filter": torch.zeros_like(state)}
        super().__init__(["joint_position"], ["joint_velocity"], states)
        self.register_buffer("matrix", matrix.clone())

    def observe(self, known: Known) -> None:
        angle, state = seen(known, "joint_position"), known["state", "joint_velocity_filter"]
        start = torch.stack([angle, torch.zeros_like(angle)], -1)
        state = at_begin(known, start, _updated(state, angle, self.get_buffer("matrix")))
        known["measured", "joint_velocity"] = state[..., 1]
        known["next", "joint_velocity_filter"] = state


class _DifferenceOnRobot(OnRobot):
    def __init__(self, previous: Tensor, control_dt: float):
        states = {"last_joint_position": torch.zeros_like(previous)}
        super().__init__(["joint_position"], ["joint_velocity"], states)
        self.control_dt = control_dt

    def observe(self, known: Known) -> None:
        angle = seen(known, "joint_position")
        previous = at_begin(known, angle, known["state", "last_joint_position"])
        known["measured", "joint_velocity"] = (angle - previous) / self.control_dt
        known["next", "last_joint_position"] = angle
