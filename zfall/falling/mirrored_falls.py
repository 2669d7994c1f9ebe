"""Falls to one side shown to a policy as falls to the other."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import Permutation, mirror_vector, mirrors_of
from zfall.envs.param_mirrors import param_mirrors
from zfall.envs.transforms.base_env import base_env_of, needs_env
from zfall.envs.transforms.observations import (
    CAPSNeighbours,
    NormalizedVector,
    ObservationVector,
)
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.falling.kneel_reference import KneelReference
from zfall.falling.modes import RECOVER
from zfall.modules.mirror import Mirror
from zfall.rotations import turn_to_heading


class MirroredFalls(Transform):
    """Shows falls to the left in a mirror, so that the policy only has to catch those to the right.

    The side of a fall is that of the velocity of the center of mass, in the robot's heading, in
    the step that leaves mode RECOVER. It stays until the world recovers or the episode ends; an
    episode that begins in another mode must begin in a fall. In a fall to the left, observations
    of policy and critic are reflected, the y axis of the world included, and ``KneelReference``
    reflects the action and its own movement. The policy learns from twice as many falls, as far
    as the robot is symmetric: angles that the arm on the other side cannot take are clamped.

    Keys: reads ``mode`` ``(N, 3)``, ``base_orientation`` ``(N, 4)`` and ``com_velocity``
    ``(N, 3)`` [m/s], measured where sensing wrote them; writes ``fall_mirrored`` ``(N, 1)`` bool
    and changes what each ``ObservationVector`` and ``NormalizedVector`` of the table wrote. Comes
    after all of these.

    Args:
        env: the base env.

    Raises:
        ValueError: without a ``KneelReference`` or a mode, if it is out of order, or if an
            observation contains a quantity without a known image, or actions, which are those of
            the reflected world already.
    """

    acts_by_itself = True  # a baseline that holds still leaves it out, with KneelReference
    measured = ("base_orientation", "com_velocity")

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys=["mode"], out_keys=["fall_mirrored"])
        needs_env(self, env, "a memory of each world")
        self.env, self.robot, self.joint_range = env, env.robot, env.joint_range
        self.vectors: dict[str, ObservationVector | NormalizedVector] = {}
        self.images: dict[str, Mirror] = {}
        self.declared: dict[str, tuple[float, ...] | Permutation | str] = {}

    def attach(self, transforms: Mapping[str, Transform]) -> None:
        """Finds the vectors of the table, and checks its order."""
        own = next(name for name, t in transforms.items() if t is self)
        if not any(isinstance(t, KneelReference) for t in transforms.values()):
            raise ValueError(
                f"transforms.{own} needs a KneelReference, which reflects what the policy does."
            )
        self.declared = mirrors_of(transforms.values())
        names = list(transforms)
        for name, transform in transforms.items():
            before = names.index(name) < names.index(own)
            if isinstance(transform, ObservationVector | NormalizedVector):
                self.vectors[name] = transform
                if not before:
                    raise ValueError(f"transforms.{own} must come after {name}, to reflect it.")
            if isinstance(transform, CAPSNeighbours) and before:
                raise ValueError(f"transforms.{own} must come before {name}, which is to be close.")

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        fell = tensordict["mode"][:, RECOVER, None] == 0
        left = torch.where(fell, tensordict["fall_mirrored"], _to_the_left(next_tensordict))
        return self._reflect(next_tensordict, left)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        return self._reflect(tensordict_reset, _to_the_left(tensordict_reset))

    def _reflect(self, tensordict: TensorDictBase, left: Tensor) -> TensorDictBase:
        mirrored = left & (tensordict["mode"][:, RECOVER, None] == 0)
        for key, image in self.images.items():
            vector = tensordict[key]
            tensordict[key] = torch.where(mirrored, image(vector), vector)
        return tensordict.set("fall_mirrored", mirrored)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        if "mode" not in observation_spec.keys():
            raise ValueError("MirroredFalls needs the key mode: put a ModeMachine before it.")
        for name, vector in self.vectors.items():
            actions = [key for key in vector.keys if key in ("action", "last_action")]
            if actions:
                raise ValueError(
                    f"transforms.{name}.keys must have no actions with MirroredFalls, which the "
                    f"policy gave in the reflected world, got {actions[0]}."
                )
            spans = vector_spans(observation_spec, vector.keys)
            affine = getattr(vector, "affine", None)
            (key,) = vector.out_keys
            declared = param_mirrors(self.env, spans) | self.declared
            self.images[key] = mirror_vector(self.robot, spans, self.joint_range, affine, declared)
        shape = (*observation_spec.shape, 1)
        observation_spec["fall_mirrored"] = Binary(shape=shape, dtype=torch.bool)
        return observation_spec


def _to_the_left(tensordict: TensorDictBase) -> Tensor:
    """Whether worlds move to the left of where they face ``(N, 1)`` bool."""
    velocity = read_measured(tensordict, "com_velocity")[:, :2]
    orientation = read_measured(tensordict, "base_orientation")
    return turn_to_heading(orientation, velocity)[:, 1:] > 0
