"""Actors: a trunk (MLP or stacked GRU) and a head (Gaussian or mixture of Gaussians)."""

from collections.abc import Sequence
from typing import Annotated, Any, Unpack, cast

import torch
from tensordict import NestedKey, unravel_key
from tensordict.nn import TensorDictModule, TensorDictModuleBase, TensorDictSequential
from torch import nn
from torchrl.data import Composite
from torchrl.modules import ProbabilisticActor

from zfall.modules.gru import StackedGRU
from zfall.modules.heads import GaussianHead, Head, HeadValues, SharedMixtureHead, make_head
from zfall.modules.normalization import ObservationNormalizer
from zfall.modules.symmetric import SymmetricEncoder, SymmetricHead, SymmetricPolicy
from zfall.modules.trunks import (
    Activation,
    Initialization,
    MemorySteps,
    check_handedness,
    check_widths,
    front,
    gru_trunk,
    hidden_key,
    mlp_trunk,
)
from zfall.values import Count, Whole, one_of


def mlp_actor(
    observation_spec: Composite,
    action_spec: Composite,
    *,
    num_cells: Sequence[Count] = (128, 128),
    activation: Activation = "elu",
    components: Whole = 0,
    initialization: Initialization = "orthogonal",
    normalize: bool = True,
    symmetric: bool = False,
    handedness: float | None = None,
    statistic: Annotated[str, one_of("mean", "mode")] = "mean",
    **head: Unpack[HeadValues],
) -> ProbabilisticActor:
    """Feed-forward actor: ``observation`` ``(*B, D)`` -> ``action`` ``(*B, J)``.

    Args:
        observation_spec, action_spec: of the env.
        num_cells: widths of the hidden layers.
        activation: behind each of them: ``elu``, ``relu`` or ``tanh``.
        initialization: of these layers, see ``mlp_trunk``.
        normalize: whether observations are centered and scaled by their statistics so far.
        symmetric: whether it acts in the mirror as the robot does there, see ``symmetric.py``.
        handedness: of a symmetric one, the input by which it may prefer a side; ``None``: there is
            none, 0: it says nothing.
        statistic: what the policy does when it does not explore, ``mean`` or ``mode``.
        components: Gaussians per joint, 0 for a plain Gaussian.
        head: ``shared_components``:
            whether all joints are of the same one, a mixture over the whole action; ``std``:
            standard deviation at the start, in units of the action; ``std_range``: its floor and
            cap; ``spread``: of the means of a mixture at the start; of a plain Gaussian
            ``learn_std``: whether it is learned, and ``state_std``:
            whether it depends on the state. See ``make_head``.

    Raises:
        ValueError: on another statistic, activation or initialization, no layer or cell, or a
            mixture of fixed deviation, or over the whole action and symmetric.
    """
    check_widths(num_cells)
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    out = make_head(num_cells[-1], joints, components=components, **head)
    check_handedness(symmetric, handedness)
    first, width = front(size, normalize, handedness)
    trunk = mlp_trunk(width, num_cells, activation, initialization)
    net: nn.Module = nn.Sequential(*first, trunk, out)
    if symmetric:
        _check_mirrored(out)
        net = SymmetricPolicy(net, out.keys, size, joints)
    module = TensorDictModule(net, in_keys=["observation"], out_keys=list(out.keys))
    return _actor(module, out, statistic)


def gru_actor(
    observation_spec: Composite,
    action_spec: Composite,
    *,
    hidden_size: Count = 64,
    num_layers: Count = 3,
    components: Whole = 3,
    initialization: Initialization = "default",
    encoder_cells: Sequence[Count] = (),
    num_cells: Sequence[Count] = (),
    activation: Activation = "elu",
    memory_steps: MemorySteps | None = None,
    residual: bool = False,
    normalize: bool = True,
    symmetric: bool = False,
    handedness: float | None = None,
    statistic: Annotated[str, one_of("mean", "mode")] = "mean",
    **head: Unpack[HeadValues],
) -> ProbabilisticActor:
    """Recurrent actor: layers of an encoder, stacked GRU cells, layers, a head.

    Without ``encoder_cells`` and ``num_cells`` the encoder is one linear layer, and the head reads
    the GRU: all but the GRU is then linear.

    Reads ``observation`` ``(*B, D)``, ``is_init`` and its own hidden state under
    ``recurrent_state_actor`` ``(*B, num_layers, hidden_size)``, whose successor it writes under
    ``("next", "recurrent_state_actor")``; writes ``action`` ``(*B, J)``. If it is symmetric it has
    a second hidden state, of the mirror, ``recurrent_state_actor_image``.

    Args:
        observation_spec, action_spec: of the env.
        hidden_size: width of the GRU layers.
        num_layers: number of GRU layers.
        components: Gaussians per joint; 0 for a plain Gaussian.
        initialization: of these layers, see ``gru_trunk``.
        encoder_cells: widths of layers in front of the linear layer that the GRU reads.
        num_cells: widths of layers between the GRU and the head.
        activation: behind each of both: ``elu``, ``relu`` or ``tanh``.
        memory_steps: up to how many steps cells remember at the start, see ``gru_trunk``; ``None``:
            about two.
        residual: whether what the GRU layers read is added to what the last of them gives, so that
            they learn a correction of it (He et al., "Deep residual learning for image
            recognition", CVPR 2016).
        normalize: whether observations are centered and scaled by their statistics so far.
        symmetric: whether it acts in the mirror as the robot does there, see ``symmetric.py``.
        handedness: of a symmetric one, the input by which it may prefer a side; ``None``: there is
            none, 0: it says nothing.
        statistic: what the policy does when it does not explore, ``mean`` or ``mode``.
        head: as of ``mlp_actor``.

    Raises:
        ValueError: on another statistic or initialization, or a mixture of fixed deviation.
    """
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    out = make_head([hidden_size, *num_cells][-1], joints, components=components, **head)
    check_handedness(symmetric, handedness)
    encoder, gru = gru_trunk(
        size,
        hidden_size,
        num_layers,
        normalize,
        initialization,
        role="actor",
        in_key="observation",
        encoder_cells=encoder_cells,
        activation=activation,
        memory_steps=memory_steps,
        handedness=handedness,
    )
    last: nn.Module = out
    if num_cells:
        last = nn.Sequential(mlp_trunk(hidden_size, num_cells, activation, initialization), out)
    grus = [gru]
    if symmetric:
        _check_mirrored(out)
        names = [
            f"{key}_image" for key in ("embedding_actor", "features_actor", hidden_key("actor"))
        ]
        grus.append(StackedGRU(hidden_size, num_layers, *names))
        grus[1].gru = gru.gru  # one network, seen twice
        both = SymmetricEncoder(encoder.module, size)
        encoder = TensorDictModule(both, ["observation"], [each.in_keys[0] for each in grus])
        last = SymmetricHead(last, out.keys, joints)
    modules = [encoder, *grus]
    if residual:
        for each in grus:
            added = [each.out_keys[0], each.in_keys[0]]
            modules.append(TensorDictModule(torch.add, in_keys=added, out_keys=added[:1]))
    read = [each.out_keys[0] for each in grus]
    modules.append(TensorDictModule(last, in_keys=read, out_keys=list(out.keys)))
    module = TensorDictSequential(*modules)
    return _actor(module, out, statistic)


def _check_mirrored(head: Head) -> None:
    """Refuses a mixture over the whole action: which Gaussian is whose image is not known."""
    if isinstance(head, SharedMixtureHead):
        raise ValueError("symmetric must be false with shared_components, got true.")


def _actor(module: TensorDictModule, head: Head, statistic: str) -> ProbabilisticActor:
    if statistic not in ("mean", "mode"):
        raise ValueError(f"statistic must be mean or mode, got {statistic!r}.")
    mixture = not isinstance(head, GaussianHead)
    actor = ProbabilisticActor(
        module,
        in_keys=list(head.keys),
        out_keys=["action"],
        distribution_class=head.distribution,
        distribution_kwargs={"statistic": statistic}
        if mixture
        else {},  # of a Gaussian both are one
        return_log_prob=True,
        log_prob_key="action_log_prob",  # whatever TensorDict's settings call it
    )
    kept = ["action", "action_log_prob"]
    recurrent = [key for key in module.out_keys if isinstance(key, tuple)]
    actor.select_out_keys(*kept, *recurrent)  # the rest need not be stored
    return actor


def normalizer_of(module: nn.Module) -> ObservationNormalizer | None:
    """The observation normaliser inside an actor or a critic, if it has one."""
    parts = (part for part in module.modules() if isinstance(part, ObservationNormalizer))
    return next(parts, None)


def normalizers_of(
    network: nn.Module, observation_spec: Composite
) -> dict[ObservationNormalizer, NestedKey]:
    """All observation normalisers inside a network, and what of the env each of them sees.

    That is what the smallest ``TensorDictModule`` around it reads, if it is one vector of its size.

    Args:
        network: an actor or a critic.
        observation_spec: of the env.

    Raises:
        ValueError: if it is none, or several.
    """
    reads: dict[ObservationNormalizer, list[NestedKey]] = {}
    for part in network.modules():  # from the outside to the inside
        if isinstance(part, TensorDictModuleBase):
            inner = (each for each in part.modules() if isinstance(each, ObservationNormalizer))
            reads |= {normalizer: list(part.in_keys) for normalizer in inner}
    found, there = {}, observation_spec.keys(True, True)
    for normalizer, keys in reads.items():
        size = len(normalizer.mean)
        fits = [k for k in keys if k in there and observation_spec[k].shape[-1] == size]
        if len(fits) != 1:
            raise ValueError(
                f"a normaliser must lie in a TensorDictModule that reads one vector of the env of "
                f"its size, {size}, got one that reads {', '.join(map(str, keys))}."
            )
        found[normalizer] = fits[0]
    return found


def recurrent_keys(module: nn.Module) -> list[NestedKey]:
    """Names of the hidden states that a network carries from step to step.

    Those that it reads, and whose successor it writes under ``("next", name)``.
    """
    reads, writes = cast(Any, module).in_keys, cast(Any, module).out_keys
    return [key for key in reads if unravel_key(("next", key)) in writes]
