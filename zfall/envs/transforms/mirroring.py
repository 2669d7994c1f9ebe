"""Falls to one side shown to a policy as falls to the other."""

from collections.abc import Mapping

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Composite
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import Mirror, mirror_vector
from zfall.envs.rotations import turn_to_heading
from zfall.envs.transforms.modes import RECOVER
from zfall.envs.transforms.observations import NormalizedVector, ObservationVector
from zfall.envs.transforms.observations.measured import read_measured
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.envs.transforms.values import reset_rows

Vector = ObservationVector | NormalizedVector


class MirroredFalls(Transform):
    """Shows falls to the left in a mirror, so that a policy has to catch those to the right alone.

    To which side a world falls is decided by the velocity of its center of mass, in the robot's
    heading, in the step in which it leaves mode RECOVER, and holds until it recovers again or the
    episode ends. If to the left, what policy and critic see is reflected at the robot's plane of
    symmetry, and ``KneelReference`` reflects what the policy does, along with its own movement.
    The policy is then as good on both sides, and learns from twice as many falls.

    Keys: reads ``mode``, ``base_orientation`` and ``com_velocity`` [m/s], as measured where
    sensing wrote it; writes ``mirrored`` ``(N, 1)`` bool and changes what the ``ObservationVector``
    and ``NormalizedVector`` of the table wrote. Comes after all of these.

    Args:
        env: the base env.

    Raises:
        ValueError: if it comes before one of those vectors, or a quantity has no known image.
    """

    falls: Tensor
    mirrored: Tensor

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys=["mode"], out_keys=["mirrored"])
        self.robot, self.joint_range = env.robot, env.joint_range
        self.vectors: dict[str, Vector] = {}
        self.images: dict[str, Mirror] = {}
        for name in ("falls", "mirrored"):
            self.register_buffer(name, torch.zeros(env.num_envs, dtype=torch.bool))

    def attach(self, transforms: Mapping[str, Transform]) -> None:
        """Finds the vectors of the table."""
        self.vectors = {name: t for name, t in transforms.items() if isinstance(t, Vector)}

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._reflect(next_tensordict, torch.ones_like(self.falls))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict)
        self.falls = self.falls & ~rows
        return self._reflect(tensordict_reset, rows)

    def _reflect(self, tensordict: TensorDictBase, rows: Tensor) -> TensorDictBase:
        falls = tensordict["mode"][:, RECOVER] == 0
        velocity = read_measured(tensordict, "com_velocity")[:, :2]
        left = turn_to_heading(read_measured(tensordict, "base_orientation"), velocity)[:, 1] > 0
        mirrored = torch.where(self.falls, self.mirrored, left) & falls
        self.mirrored = torch.where(rows, mirrored, self.mirrored)
        self.falls = torch.where(rows, falls, self.falls)
        for key, image in self.images.items():
            vector = tensordict[key]
            tensordict[key] = torch.where(self.mirrored[:, None], image(vector), vector)
        return tensordict.set("mirrored", self.mirrored[:, None])

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        for name, vector in self.vectors.items():
            (key,) = vector.out_keys
            if key not in observation_spec.keys():
                raise ValueError(
                    f"MirroredFalls must come after transforms.{name}, which it reflects."
                )
            spans = vector_spans(observation_spec, vector.keys)
            affine = getattr(vector, "affine", None)
            self.images[key] = mirror_vector(self.robot, spans, self.joint_range, affine)
        observation_spec["mirrored"] = Binary(shape=(*observation_spec.shape, 1), dtype=torch.bool)
        return observation_spec
