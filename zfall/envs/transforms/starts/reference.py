"""Starts in the midst of reference motions."""

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import needs_env, streams_of
from zfall.envs.transforms.values import per_world, refuse_start, reset_rows
from zfall.fingerprints import reads_files
from zfall.motions.library import load_motions, motions_file
from zfall.rotations import rotate, turned
from zfall.simulation.quantities import STATE_KEYS
from zfall.values import Names, NotNegative


@reads_files(lambda values, robot: [motions_file(robot)])
class ReferenceStart(Transform):
    """Starts episodes in the midst of reference motions, with Gaussian noise on the joints.

    A motion and its phase are drawn uniformly; where the base is then is the origin, and the way
    it faces is that of x, or any if ``heading``. The lowest corner of the soles is put on the
    floor: in the motions it is there, and noise would push a sole into it otherwise.

    Writes, for the reset of the base env, ``("start", NAME)`` ``(N, ...)`` for all ``STATE_KEYS``
    but ``base_position``; angles are clamped to the joint ranges.

    Args:
        env: the base env.
        motions: names of motions, see ``docs/reference/motions.md``; all if ``None``.
        joint_position: standard deviation of each angle [rad].
        joint_velocity: standard deviation of each speed [rad/s].
        heading: whether to turn the robot by an angle drawn uniformly.

    Raises:
        ValueError: on an unknown motion or none, a negative standard deviation, or a robot
            without motions; at a reset, after another start that gives a position of the base.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV-B. The motions are our own; the size of the noise is not published.
    """

    replaced_in_batteries = True  # by starts of a battery

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        motions: Names | None = None,
        joint_position: NotNegative = 0.0,
        joint_velocity: NotNegative = 0.0,
        heading: bool = False,
    ):
        super().__init__()
        needs_env(self, env, "the begin of episodes")
        for name, std in (("joint_position", joint_position), ("joint_velocity", joint_velocity)):
            if std < 0:
                raise ValueError(f"{name} must not be negative, got {std}.")
        there = load_motions(env.robot)
        names = list(there if motions is None else motions)
        unknown = [name for name in names if name not in there]
        if unknown or not names:
            got = unknown[0] if unknown else "none"
            raise ValueError(f"motions must be of {', '.join(there)}, got {got}.")
        self.joint_position, self.joint_velocity = joint_position, joint_velocity
        self.heading = heading
        self.range, self.num_envs = env.joint_range, env.num_envs
        chosen = [there[name].states for name in names]
        self.count = torch.tensor([len(states["joint_position"]) for states in chosen])
        self.first = self.count.cumsum(0) - self.count
        keys = [key for key in STATE_KEYS if key != "base_position"]
        states = {
            key: torch.from_numpy(np.concatenate([states[key] for states in chosen]))
            for key in keys
        }
        ahead = rotate(states["base_orientation"], torch.tensor([[1.0, 0.0, 0.0]]))
        _turn(states, -torch.atan2(ahead[:, 1], ahead[:, 0]))
        self.sizes = {key: states[key].shape[-1] for key in keys}
        self.table = torch.cat([states[key] for key in keys], -1)  # one look-up for all

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        refuse_start(self, tensordict, "base_position")
        rows, stream = reset_rows(tensordict), streams_of(self)
        motion = stream.integers(len(self.count), (), rows)
        phase, angle = stream.uniform((2,), rows).unbind(-1)
        row = self.first[motion] + (phase * self.count[motion]).long()
        values = self.table.index_select(0, row).split(list(self.sizes.values()), -1)
        start = dict(zip(self.sizes, values, strict=True))
        if self.heading:
            _turn(start, 2.0 * torch.pi * angle)
        joints = start["joint_position"]
        noise = stream.normal((2, joints.shape[-1]), rows)
        low, high = self.range.unbind(-1)
        joints = joints + per_world(self.joint_position, 2) * noise[:, 0]
        start["joint_position"] = torch.clamp(joints, low, high)
        start["joint_velocity"] += per_world(self.joint_velocity, 2) * noise[:, 1]
        for name, value in start.items():
            tensordict["start", name] = value
        return tensordict


def _turn(states: dict[str, Tensor], angle: Tensor) -> None:
    """Turns the base and its velocity by ``angle`` ``(K,)`` [rad] about the world's up axis."""
    cos, sin = angle.cos(), angle.sin()
    x, y, z = states["base_linear_velocity"].unbind(-1)
    states["base_linear_velocity"] = torch.stack([cos * x - sin * y, sin * x + cos * y, z], -1)
    states["base_orientation"] = turned(states["base_orientation"], angle)
