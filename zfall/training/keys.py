"""The keys of ``recipes/train.yaml``, and what their values may be; loads nothing."""

import re
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, NotRequired, TypedDict

from zfall.values import (
    Count,
    Fraction,
    FractionAboveZero,
    FractionBelowOne,
    Name,
    Node,
    NotNegative,
    Positive,
    PositiveOrInfinite,
    Rule,
    Seed,
    Whole,
)

Device = Annotated[
    str,
    Rule("be cpu, cuda or cuda:NUMBER", lambda x: re.fullmatch(r"cpu|cuda(:\d+)?", x) is not None),
]


class LossKeys(TypedDict):
    """The group ``loss`` of ``recipes/train.yaml``."""

    gamma: Fraction
    lmbda: Fraction
    clip_epsilon: FractionAboveZero
    critic_coeff: NotNegative
    entropy_coeff: NotNegative
    normalize_advantage: Literal["minibatch", "batch"] | None
    kl_stop: Positive | None
    kl_coeff: NotNegative
    kl_target: Positive | None
    value_clip: Positive | None
    value_error_clip: Positive | None


class NormKeys(TypedDict):
    """``max_grad_norm`` with a bound for each network."""

    actor: PositiveOrInfinite
    critic: PositiveOrInfinite


class Launch(TypedDict):
    """The processes of a training."""

    ranks: Count | None
    timeout: Positive


class Showcase(TypedDict):
    """What is shown at the end of a training, and before."""

    battery: NotRequired[Name]
    every: NotRequired[Count | None]
    sizes: Annotated[Sequence[Positive], Rule("hold at least one size", lambda x: len(x) > 0)]
    starts: Count
    video: bool


class TrainKeys(TypedDict):
    """The keys of ``recipes/train.yaml``."""

    seed: Seed
    num_envs: Count
    groups: Count | None
    total_frames: Positive
    alike: Count
    rollout_steps: Count
    epochs: Count
    minibatches: Count
    burn_in: Whole
    max_grad_norm: PositiveOrInfinite | NormKeys
    statistics_batches: Whole
    averaging: FractionBelowOne
    resume: Name | None
    warm_start: Name | None
    checkpoint_every: Count
    name: Name | int | None
    launch: Launch
    device: Device
    logger: Sequence[Node] | None
    auxiliary_losses: Mapping[str, Node | None]
    auxiliary_share: FractionAboveZero
    augmentation: Node | None
    optimizer: Node
    scheduler: Node | None
    showcase: Showcase | None
    env: Node
    actor: Node
    critic: Node
    loss: Mapping[str, Any]
    trust: Sequence[Name]
    stages: Mapping[str, Any]
    recover: NotRequired[Name]  # of an experiment that begins with a policy: which
    experiment: NotRequired[Any]
