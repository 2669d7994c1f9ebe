"""Physics that differs from world to world, and sensors that are not mounted quite right."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.streams import Stream
from zfall.envs.transforms.base_env import base_env_of, needs_env, on_data, streams_of
from zfall.envs.transforms.values import per_world, reset_rows, two_numbers
from zfall.rotations import rotate
from zfall.simulation.parameters import ANY_NUMBER
from zfall.values import NotNegative, Positive

_KINDS = ("uniform", "log_uniform", "normal")


class DomainRandomization(Transform):
    """Draws physical parameters for every world at the beginning of an episode.

    Keys: writes the values in force under ``("params", name)`` ``(N, size)``, for the critic to
    see; ``HumanoidEnv.physics_param_spec`` lists names and sizes, ``PhysicsParameters`` units.

    Args:
        env: the base env.
        params: by name, what to draw from: ``{uniform: [low, high]}``, ``{log_uniform: [low,
            high]}`` or ``{normal: [mean, standard deviation]}``, each entry of the parameter on
            its own; with ``shared: true`` one draw for all entries, and with ``clip: [low, high]``
            cut to bounds. What a normal distribution draws beyond the ``ranges`` of
            ``PhysicsParameters`` is cut to them.
        interval: time after which the parameters are drawn again within an episode [s]; ``null``
            keeps them for the whole episode.

    Raises:
        ValueError: on a parameter that does not exist, a distribution that is none, or one that
            reaches beyond those ``ranges``.
    """

    hardware = "physics"
    clock: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        params: Mapping[str, Mapping[str, Any]],
        interval: Positive | None = None,
    ):
        super().__init__(in_keys_inv=["params"], out_keys_inv=["params"])
        needs_env(self, env, "physics to act on")
        self.spec, self.ranges = env.physics_param_spec, env.parameters.ranges
        for name, distribution in params.items():
            if name not in self.spec.keys():
                raise ValueError(f"params must be of {', '.join(self.spec.keys())}, got {name!r}.")
            _check(f"params.{name}", distribution, self.ranges.get(name, ANY_NUMBER))
        if interval is not None and interval < env.control_dt:
            raise ValueError(
                f"interval must be at least control_dt ({env.control_dt}), got {interval}."
            )
        self.params = {name: dict(value) for name, value in params.items()}
        self.interval, self.control_dt = interval, env.control_dt
        self.num_envs = env.num_envs
        self.register_buffer("clock", torch.zeros(env.num_envs))  # since the last draw [s]

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        self._draw(reset_rows(tensordict, self))
        return tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._write(tensordict_reset)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        base_env_of(self)
        if self.interval is not None:
            self._draw(self.clock > self.interval - 0.5 * self.control_dt)
            self.clock = self.clock + self.control_dt
        return tensordict

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._write(next_tensordict)

    def _write(self, tensordict: TensorDictBase) -> TensorDictBase:
        values = base_env_of(self).parameters.values
        for name in self.params:  # replaced as a whole when drawn, never written into
            tensordict["params", name] = values[name]
        return tensordict

    def _draw(self, rows: Tensor) -> None:
        env = base_env_of(self)
        drawn = {
            name: draw(
                distribution,
                self.spec[name].shape[1],
                streams_of(self, name),  # whatever else is drawn
                rows,
                self.ranges.get(name, ANY_NUMBER),
            )
            for name, distribution in self.params.items()
        }
        env.set_physics_params(TensorDict(drawn, batch_size=[self.num_envs]), rows)
        if self.interval is not None:
            self.clock = torch.where(rows, 0.0, self.clock)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for name in self.params:
            observation_spec["params", name] = self.spec[name].clone()
        return observation_spec


def draw(
    distribution: Mapping[str, Any],
    size: int,
    stream: Stream,
    rows: Tensor,
    bounds: tuple[float, float] = ANY_NUMBER,
) -> Tensor:
    """Values ``(N, size)`` from a distribution as in ``DomainRandomization``.

    They are cut to ``bounds``, as those of a normal one need. What is not in ``rows`` ``(N,)``
    means nothing.
    """
    (kind,) = (kind for kind in _KINDS if kind in distribution)
    width = 1 if distribution.get("shared", False) else size
    # Bounds may be one pair for all worlds or, from a curriculum, a pair for each (2, N).
    first, second = (per_world(x, 2) for x in distribution[kind])
    if kind == "normal":
        values = first + second * stream.normal((width,), rows)
    else:
        u = stream.uniform((width,), rows)
        if kind == "uniform":
            values = u.mul_(second - first).add_(first)
        else:
            values = first * (second / first) ** u
    clip = distribution.get("clip")
    if clip is not None:
        low, high = (torch.as_tensor(per_world(x, 2)) for x in clip)
        values = torch.clamp(values, low, high)
    return values.float().clamp(*bounds).expand(len(rows), size)


def _check(name: str, distribution: Mapping[str, Any], bounds: tuple[float, float]) -> None:
    """Raises ``ValueError`` unless the distribution is one, of values within ``bounds``."""
    kinds = [kind for kind in _KINDS if kind in distribution]
    unknown = sorted(set(distribution) - {*_KINDS, "shared", "clip"})
    if len(kinds) != 1 or unknown:
        raise ValueError(
            f"{name} must hold just one of {', '.join(_KINDS)}, and may hold shared and clip; "
            f"got {', '.join(distribution) or 'nothing'}."
        )
    (kind,) = kinds
    first, second = two_numbers(f"{name}.{kind}", distribution[kind])
    if kind == "normal" and second < 0:
        raise ValueError(f"{name}.normal must be [mean, deviation >= 0], got {[first, second]}.")
    if kind == "log_uniform" and not first > 0:
        raise ValueError(f"{name}.log_uniform must be of positive values, got {[first, second]}.")
    ranges = {} if kind == "normal" else {kind: (first, second)}
    if distribution.get("clip") is not None:
        ranges["clip"] = two_numbers(f"{name}.clip", distribution["clip"])
    for key, (low, high) in ranges.items():
        if not low <= high:
            raise ValueError(f"{name}.{key} must be [low, high], got {[low, high]}.")
        least, most = np.array([low, high], np.float32).tolist()  # like the values
        if not bounds[0] <= least <= most <= bounds[1]:
            raise ValueError(
                f"{name}.{key} must be within [{bounds[0]:.3g}, {bounds[1]:.3g}], "
                f"got {[low, high]}."
            )


class JointZeroOffset(Transform):
    """Encoders that do not read zero at zero: a constant of each joint, drawn per episode.

    The servo, too, follows what its encoder reads, through the physical parameter
    ``joint_zero_offset``, which ``DomainRandomization`` must draw.

    Keys: reads ``joint_position`` (what is measured, if an earlier transform measured it) and
    ``("params", "joint_zero_offset")`` ``(N, J)`` [rad], writes ``("measured",
    "joint_position")`` ``(N, J)`` [rad], their sum.
    """

    hardware = "sensors"
    forward = on_data

    def __init__(self) -> None:
        key = ("measured", "joint_position")
        super().__init__(in_keys=["joint_position"], out_keys=[key])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        value = next_tensordict.get(self.out_keys[0], None)
        value = next_tensordict["joint_position"] if value is None else value
        offset = next_tensordict["params", "joint_zero_offset"]
        return next_tensordict.set(self.out_keys[0], value + offset)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        if ("params", "joint_zero_offset") not in observation_spec.keys(True):
            raise ValueError(
                "JointZeroOffset must come after a DomainRandomization whose params hold "
                "joint_zero_offset; there is none."
            )
        observation_spec["measured", "joint_position"] = observation_spec["joint_position"].clone()
        return observation_spec


class ImuMisalignment(Transform):
    """An IMU that is mounted askew: a constant small rotation of all that it measures.

    Keys: reads each of ``keys`` ``(N, 3)`` [body axes] (what is measured, if an earlier transform
    measured it) and writes it in the axes of the IMU under ``("measured", key)``; writes the
    rotation vector under ``("params", "imu_misalignment")`` ``(N, 3)`` [rad].

    Args:
        env: the base env.
        angle: largest angle about each axis [rad]; drawn per episode, uniform.
        keys: what the IMU measures.

    Raises:
        ValueError: on a negative angle or a key that is not a vector.
    """

    hardware = "sensors"
    mirror_signs = {"params/imu_misalignment": (-1.0, 1.0, -1.0)}  # an axial vector
    rotation: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        angle: NotNegative,
        keys: Sequence[str] = ("projected_gravity", "base_angular_velocity", "base_acceleration"),
    ):
        super().__init__(in_keys=list(keys), out_keys=[("measured", key) for key in keys])
        needs_env(self, env, "a memory of each world")
        if angle < 0:
            raise ValueError(f"angle must not be negative, got {angle}.")
        self.angle = angle
        self.register_buffer("rotation", torch.zeros(env.num_envs, 3))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        half = 0.5 * self.rotation.norm(dim=-1, keepdim=True)
        axis = torch.nn.functional.normalize(self.rotation, dim=-1)
        # A vector fixed in the body turns the other way in the axes of the turned IMU.
        turn = torch.cat([half.cos(), -half.sin() * axis], -1)
        for key, out_key in zip(self.in_keys, self.out_keys, strict=True):
            value = next_tensordict.get(out_key, None)
            value = next_tensordict[key] if value is None else value
            next_tensordict[out_key] = rotate(turn, value)
        next_tensordict["params", "imu_misalignment"] = self.rotation.clone()
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        u = 2.0 * streams_of(self).uniform((3,), rows) - 1.0
        angle = torch.as_tensor(self.angle).reshape(-1, 1)
        self.rotation = torch.where(rows[:, None], angle * u, self.rotation)
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        for key in self.in_keys:
            if observation_spec[key].shape[1:] != (3,):
                raise ValueError(f"keys must name vectors of 3, got {key}.")
            observation_spec["measured", key] = observation_spec[key].clone()
        observation_spec["params", "imu_misalignment"] = observation_spec[self.in_keys[0]].clone()
        return observation_spec
