"""Left-right symmetry: mirrored copies of a batch."""

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from zfall.envs.robots import Robot
from zfall.envs.transforms.observations import ObservationVector

_JOINTS = ("joint_position", "joint_velocity", "joint_torque", "target", "action", "last_action")
_POLAR = ("projected_gravity", "base_position", "base_linear_velocity", "base_acceleration")
_POLAR += ("com_position", "com_velocity", "linear_momentum", ("push", "force"))
_AXIAL = ("base_angular_velocity", "angular_momentum")
_FEET = ("feet_position", "feet_velocity", "feet_force")


class Mirror:
    """Exchanges left and right in the observations and actions of a batch.

    The mirror plane is the world's x-z plane: positions, velocities and forces change the sign of
    y, angular velocities and momenta those of x and z, the feet and the joints of both sides
    change places (``Robot.mirror_index`` and ``mirror_sign``).

    Args:
        robot: gives the mirror of the joints.
        vectors: for each key of a batch, the quantities it lines up, as in ``ObservationVector``.

    Raises:
        ValueError: on a quantity whose mirror image is not known.
    """

    def __init__(self, robot: Robot, vectors: dict[str, list[NestedKey]]):
        self._maps: dict[str, tuple[Tensor, Tensor]] = {}
        for name, keys in vectors.items():
            index: list[int] = []
            sign: list[float] = []
            for key in keys:
                places, signs = _mirror_of(key, robot)
                index += [len(index) + place for place in places]
                sign += signs
            self._maps[name] = (torch.tensor(index), torch.tensor(sign))

    @classmethod
    def of(cls, env: TransformedEnv) -> "Mirror":
        """The mirror of an env's observation vectors and of its action."""
        vectors: dict[str, list[NestedKey]] = {"action": ["action"]}
        for transform in env.transform:
            if isinstance(transform, ObservationVector):
                vectors[transform.out_keys[0]] = transform.keys
        return cls(env.base_env.robot, vectors)

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """A mirrored copy; keys that are not vectors of ours are shared."""
        out = batch.copy()
        for name, (index, sign) in self._maps.items():
            if name in batch.keys():
                out[name] = batch[name][..., index] * sign
        return out


def _mirror_of(key: NestedKey, robot: Robot) -> tuple[list[int], list[float]]:
    """Where each number of a quantity comes from, and with which sign."""
    if key in _JOINTS:
        return list(robot.mirror_index), list(robot.mirror_sign)
    if key in _POLAR:
        return [0, 1, 2], [1.0, -1.0, 1.0]
    if key in _AXIAL:
        return [0, 1, 2], [-1.0, 1.0, -1.0]
    if key in _FEET:
        return [3, 4, 5, 0, 1, 2], [1.0, -1.0, 1.0] * 2
    if key == "feet_contact":
        return [1, 0], [1.0, 1.0]
    if key == "base_orientation":
        return [0, 1, 2, 3], [1.0, -1.0, 1.0, -1.0]
    raise ValueError(f"the mirror image of {key!r} is not known to zfall.losses.symmetry.")
