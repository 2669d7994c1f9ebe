"""From a plan of pushes to the wrench on the bodies; what random and scripted pushes share."""

from collections.abc import Sequence

import numpy as np
import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.pushes.profiles import find_profile, force_share

_MEASURES = ("peak_force", "impulse", "size")


class PushForces:
    """Forces on push points, E per world, integrated over physics steps.

    Args:
        env: the base env.
        points: names of push points or links.
        profile: how a force goes over the duration.

    Raises:
        ValueError: on a point that does not exist.
    """

    def __init__(self, env: HumanoidEnv, points: Sequence[str], profile: str):
        if not points:
            raise ValueError("point must name at least one push point, got none.")
        self.bodies = torch.tensor([env.push_target(point) for point in points])
        self.profile = find_profile(profile)
        self.physics_dt, self.control_dt = env.physics_dt, env.control_dt
        self.shape = (env.num_envs,)
        self.begin = env.physics_dt * np.arange(env.substeps)
        self.impulse_unit = env.robot.impulse_unit
        self._acted: dict[tuple[str, str], Tensor] = {}  # from the inverse pass to the step's end

    def apply(
        self,
        env: HumanoidEnv,
        tensordict: TensorDictBase,
        start: Tensor,
        duration: Tensor,
        force: Tensor,
        body: Tensor,
    ) -> None:
        """Adds the coming control step's share of the pushes to the TensorDict.

        Args:
            env: the base env.
            tensordict: of the step; ``("push", "wrench")`` is added to.
            start: begin of the pushes ``(N, E)`` [s from now], float64: times add up over episodes.
            duration: their length ``(N, E)`` [s].
            force: their peak force ``(N, E, 3)`` [N; world].
            body: index of the point each acts at ``(N, E)``, into ``points``.
        """
        # Most worlds are not being pushed, and for few NumPy takes a third of torch's time.
        begun, length = start.numpy(), duration.numpy().astype(np.float64)
        acting = (begun < self.control_dt) & (begun + length > 0.0)
        rows = np.flatnonzero(acting.any(1))
        length, peak_force, index = length[rows], force.numpy()[rows], torch.from_numpy(rows)
        share = force_share(self.begin, self.physics_dt, begun[rows], length, self.profile)
        parts = share[..., None] * peak_force[:, :, None]
        act = parts.sum(1)
        if len(self.bodies) == 1:
            env.add_force(tensordict, int(self.bodies), torch.from_numpy(act), index)
        else:
            for event in range(parts.shape[1]):
                target, part = self.bodies[body[index, event]], torch.from_numpy(parts[:, event])
                env.add_force(tensordict, target, part, index)
        peak = np.sqrt(np.vecdot(peak_force, peak_force)) * (share > 1e-6).any(-1)
        impulse = self.profile.mean * (peak * length).max(1, keepdims=True)
        acted = {
            ("push", "force"): act.mean(1),
            ("push", "peak_force"): peak.max(1, keepdims=True),
            ("push", "impulse"): impulse,
            ("push", "size"): impulse / self.impulse_unit,
        }
        shapes = self.keys()
        self._acted = {key: torch.zeros(shapes[key]) for key in acted}
        for key, value in acted.items():
            self._acted[key].numpy()[rows] = value

    def keys(self) -> dict[tuple[str, str], tuple[int, int]]:
        """Keys that observe the pushes, and their shapes."""
        shapes = {("push", "force"): (*self.shape, 3)}
        return shapes | {("push", key): (*self.shape, 1) for key in _MEASURES}

    def observe(self, next_tensordict: TensorDictBase) -> None:
        """Writes what acted in the step just taken, besides what other pushes wrote of it."""
        for key, value in self._acted.items():
            there = next_tensordict.get(key, None)
            if there is not None:
                value = there + value if key[1] == "force" else torch.maximum(there, value)
            next_tensordict[key] = value

    def clear(self, tensordict: TensorDictBase) -> None:
        """Writes that nothing acted yet."""
        for key, shape in self.keys().items():
            tensordict[key] = torch.zeros(shape)

    def specify(self, observation_spec: Composite) -> None:
        """Declares the keys."""
        for key, shape in self.keys().items():
            observation_spec[key] = Unbounded(shape)
