"""What a loss may ask about the task that it is trained in."""

from dataclasses import dataclass, field, replace
from typing import Any

import torch
from omegaconf import DictConfig
from torchrl.envs import TransformedEnv

from zfall.envs.mirror import Mirror, mirror_action, mirror_vector, mirrors_of
from zfall.envs.param_mirrors import param_mirrors
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.fingerprints import weights_digest
from zfall.policies.load import read_teacher


@dataclass(frozen=True)
class TaskFacts:
    """Facts about a training's task.

    Args:
        env: of the training.
        cfg: of the training.
        place: of the loss that asks, for messages.

    Attributes:
        teachers: digests of the policies that were asked for, by the place of the loss.
    """

    env: TransformedEnv
    cfg: DictConfig
    place: str = ""
    teachers: dict[str, str] = field(default_factory=dict)

    def at(self, place: str) -> "TaskFacts":
        """The same for a loss at another place of the config."""
        return replace(self, place=place)

    def spans(self, key: str = "observation") -> dict[str, slice]:
        """Where each quantity lies in an observation, by name; empty if it is no known vector."""
        return self._vector(key)[0]

    def mirror(self, key: str) -> Mirror:
        """The reflection of an observation, or of the action.

        Raises:
            ValueError: if a quantity in it has no known mirror image.
        """
        base = self.env.base_env
        if key == "action":
            return mirror_action(base.robot, self.env.action_spec.shape[-1])
        spans, vector = self._vector(key)
        size = self.env.observation_spec[key].shape[-1]
        if max((span.stop for span in spans.values()), default=0) != size:
            raise ValueError(
                f"a mirrored {key} must be one vector of quantities, got {size} values."
            )
        affine = getattr(vector, "affine", None)
        declared = param_mirrors(base, spans) | mirrors_of(self.env.transform)
        return mirror_vector(base.robot, spans, base.joint_range, affine, declared)

    def policy(self, run: object) -> torch.nn.Module:
        """A trained policy that sees and does the same, to learn from.

        Raises:
            ValueError: if there is none, or it sees or does something else.
        """
        policy = read_teacher(run, self.cfg, f"{self.place}.teacher")
        self.teachers[self.place] = weights_digest(policy)
        return policy

    def _vector(self, key: str) -> tuple[dict[str, slice], Any]:
        """Where quantities lie in an observation, and the transform that lines them up."""
        vectors = [t for t in self.env.transform if t.out_keys == [key] and hasattr(t, "keys")]
        if not vectors:
            return {}, None
        return vector_spans(self.env.observation_spec, vectors[-1].keys), vectors[-1]
