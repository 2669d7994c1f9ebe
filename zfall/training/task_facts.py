"""What a loss may ask about the task that it is trained in."""

from dataclasses import dataclass, field, replace
from typing import Any

import torch
from omegaconf import DictConfig
from tensordict import NestedKey
from torch import Tensor
from torchrl.envs import CatFrames, TransformedEnv

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
        read_by_losses: what auxiliary losses read of the world, for an augmentation to change.

    Attributes:
        teachers: digests of the policies that were asked for, by the place of the loss.
    """

    env: TransformedEnv
    cfg: DictConfig
    place: str = ""
    read_by_losses: tuple[NestedKey, ...] = ()
    teachers: dict[str, str] = field(default_factory=dict)

    def at(self, place: str) -> "TaskFacts":
        """The same for a loss at another place of the config."""
        return replace(self, place=place)

    def spans(self, key: str = "observation") -> dict[str, slice | Tensor]:
        """Where each quantity lies in an observation, by name; empty if it is no known vector.

        Slices; of a stack of vectors, as ``CatFrames`` makes it, the places in all of them.
        """
        spans, _, frames = self._vector(key)
        if frames == 1:
            return dict(spans)
        places = torch.arange(self.env.observation_spec[key].shape[-1]).unflatten(0, (frames, -1))
        return {name: places[:, span].flatten() for name, span in spans.items()}

    def mirror(self, key: NestedKey) -> Mirror:
        """The reflection of the action, of an observation, or of a quantity by itself.

        Raises:
            ValueError: if the env does not give it, or a quantity in it has no known mirror image.
        """
        base = self.env.base_env
        if key == "action":
            return mirror_action(base.robot, self.env.action_spec.shape[-1])
        if key not in self.env.observation_spec.keys(True):
            raise ValueError(
                f"what networks see must be given by the env to be mirrored, {key} is not; without "
                "mirror images, symmetry=none."
            )
        size = self.env.observation_spec[key].shape[-1]
        spans, vector, frames = self._vector(key)
        if not spans:
            writers = [t for t in self.env.transform if key in (t.out_keys or ())]
            if any(hasattr(transform, "keys") for transform in writers):
                raise ValueError(
                    f"a mirrored {key} must be one vector of quantities, or a stack of them by "
                    f"CatFrames along its last axis, got what {type(writers[-1]).__name__} writes."
                )
            spans = {key if isinstance(key, str) else "/".join(key): slice(0, size)}
        affine = getattr(vector, "affine", None)
        declared = param_mirrors(base, spans) | mirrors_of(self.env.transform)
        image = mirror_vector(base.robot, spans, base.joint_range, affine, declared)
        return image if frames == 1 else image.stacked(frames)

    def policy(self, run: object, sees: str = "observation") -> torch.nn.Module:
        """A trained policy to learn from.

        Args:
            run: a run folder, or the name of a policy that ships.
            sees: the vector of this task that it is shown as its ``observation``.

        Raises:
            ValueError: if there is none, or it sees or does something else.
        """
        policy = read_teacher(run, self.cfg, f"{self.place}.teacher", sees)
        self.teachers[self.place] = weights_digest(policy)
        return policy

    def _vector(self, key: NestedKey) -> tuple[dict[str, slice], Any, int]:
        """Where quantities lie in an observation, what lines them up, and how often.

        Nothing if they are lined up by a transform that is not known, or changed by one.
        """
        frames, whole = 1, self.env.observation_spec[key].shape[-1]
        for transform in reversed(list(self.env.transform)):
            if key not in (transform.out_keys or ()):
                continue
            if isinstance(transform, CatFrames) and transform.dim == -1:
                frames *= transform.N
                key = transform.in_keys[transform.out_keys.index(key)]
            elif transform.out_keys == [key] and hasattr(transform, "keys"):
                spans = vector_spans(self.env.observation_spec, transform.keys)
                size = max(span.stop for span in spans.values())
                return (spans, transform, frames) if frames * size == whole else ({}, None, 1)
            else:
                break
        return {}, None, 1
