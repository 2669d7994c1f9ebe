"""Actors: a trunk (MLP or stacked GRU) and a head (Gaussian or mixture of Gaussians)."""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Unpack, cast

import torch
from tensordict import NestedKey, unravel_key
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.data import Composite
from torchrl.modules import ProbabilisticActor

from zfall.modules.gru import StackedGRU
from zfall.modules.heads import GaussianHead, Head, HeadValues, make_head
from zfall.modules.normalization import ObservationNormalizer
from zfall.modules.symmetric import SymmetricPolicy
from zfall.values import Count, Rule, Whole, one_of

_ACTIVATIONS: dict[str, type[nn.Module]] = {"elu": nn.ELU, "relu": nn.ReLU, "tanh": nn.Tanh}
Activation = Annotated[str, one_of(*_ACTIVATIONS)]
Initialization = Annotated[str, one_of("orthogonal", "default")]
MemorySteps = Annotated[float, Rule("be at least 2 and finite", lambda x: 2 <= x < math.inf)]


def mlp_trunk(
    size: int,
    num_cells: Sequence[int],
    activation: str = "elu",
    initialization: str = "orthogonal",
) -> nn.Sequential:
    """Linear layers with an activation behind each.

    Weights are drawn layer by layer: ``orthogonal`` of gain sqrt(2) with biases of zero, or as
    torch does by itself, ``default``.

    Raises:
        ValueError: on an unknown activation or initialization, or no layer or cell.
    """
    _check_initialization(initialization)
    _check_widths(num_cells)
    if activation not in _ACTIVATIONS:
        names = ", ".join(_ACTIVATIONS)
        raise ValueError(f"activation must be one of {names}, got {activation!r}.")
    layers: list[nn.Module] = []
    for cells in num_cells:
        linear = nn.Linear(size, cells)
        if initialization == "orthogonal":
            nn.init.orthogonal_(linear.weight, math.sqrt(2))
            nn.init.zeros_(linear.bias)
        layers += [linear, _ACTIVATIONS[activation]()]
        size = cells
    return nn.Sequential(*layers)


def gru_trunk(
    size: int,
    hidden_size: int,
    num_layers: int,
    normalize: bool | str | ObservationNormalizer,
    initialization: str,
    *,
    role: str,
    in_key: str,
    encoder_cells: Sequence[int] = (),
    activation: str = "elu",
    memory_steps: float | None = None,
) -> tuple[TensorDictModule, StackedGRU]:
    """A linear layer and stacked GRU cells: ``in_key`` ``(*B, size)`` -> ``features_ROLE``.

    In front of the linear layer there may be an ``mlp_trunk`` of ``encoder_cells``. Weights are
    drawn layer by layer: ``orthogonal``, those of each gate by themselves, with biases of zero, or
    as torch does by itself, ``default``. The hidden state is ``recurrent_state_ROLE``.

    Of what a cell remembers, a GRU keeps about half in each step at the start, and the gradient
    through many steps vanishes. With ``memory_steps`` T the biases of the gates that keep are
    log(u), u uniform from 1 to T - 1, so that cells remember for 2 to T steps.

    Raises:
        ValueError: on an unknown initialization, no layer or cell, or fewer than 2 steps.

    Source of these biases: Tallec and Ollivier, "Can recurrent neural networks warp time?",
    ICLR 2018.
    """
    _check_initialization(initialization)
    if memory_steps is not None and not 2 <= memory_steps < math.inf:
        raise ValueError(f"memory_steps must be at least 2 and finite, got {memory_steps}.")
    for name, value in (("hidden_size", hidden_size), ("num_layers", num_layers)):
        if value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}.")
    front = [mlp_trunk(size, encoder_cells, activation, initialization)] if encoder_cells else []
    linear = nn.Linear(encoder_cells[-1] if encoder_cells else size, hidden_size)
    embedding, features, hidden = f"embedding_{role}", f"features_{role}", hidden_key(role)
    gru = StackedGRU(hidden_size, num_layers, embedding, features, hidden)
    if initialization == "orthogonal":
        for name, values in [*linear.named_parameters(), *gru.named_parameters()]:
            if "bias" in name:
                nn.init.zeros_(values)
            else:
                for gate in values.split(hidden_size):
                    nn.init.orthogonal_(gate)
    if memory_steps is not None:
        for name, values in gru.named_parameters():
            if "bias" in name:
                keeps = values.data[hidden_size : 2 * hidden_size]
                both = torch.empty_like(keeps).uniform_(1.0, memory_steps - 1.0).log()
                keeps.copy_(both if "bias_ih" in name else torch.zeros_like(keeps))
    encoder = nn.Sequential(*normalizer(size, normalize), *front, linear)
    return TensorDictModule(encoder, in_keys=[in_key], out_keys=[embedding]), gru


def hidden_key(role: str) -> str:
    """Name of the hidden state of an ``actor`` or a ``critic``."""
    return f"recurrent_state_{role}"


def _check_widths(num_cells: Sequence[int]) -> None:
    if not num_cells or min(num_cells) < 1:
        raise ValueError(f"num_cells must be widths of at least 1, one or more, got {num_cells}.")


def _check_initialization(initialization: str) -> None:
    if initialization not in ("orthogonal", "default"):
        raise ValueError(f"initialization must be orthogonal or default, got {initialization!r}.")


def normalizer(size: int, normalize: bool | str | ObservationNormalizer) -> list[nn.Module]:
    """What stands before the first layer: a normaliser, new or shared, or nothing.

    Raises:
        ValueError: if the one to be shared is of another size, or if it is a word.
    """
    if isinstance(normalize, str):
        raise ValueError(
            f"normalize must be true or false, of a critic also shared, got {normalize}."
        )
    if isinstance(normalize, ObservationNormalizer):
        if len(normalize.mean) != size:
            raise ValueError(
                f"a shared normaliser must have the size of the observation, {size}, "
                f"got {len(normalize.mean)}."
            )
        return [normalize]
    return [ObservationNormalizer(size)] if normalize else []


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
        symmetric: whether it acts in the mirror as the robot does there, see ``SymmetricPolicy``.
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
            mixture that is symmetric or of fixed deviation.
    """
    _check_widths(num_cells)
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    out = make_head(num_cells[-1], joints, components=components, **head)
    trunk = mlp_trunk(size, num_cells, activation, initialization)
    net: nn.Module = nn.Sequential(*normalizer(size, normalize), trunk, out)
    if symmetric:
        if components:
            raise ValueError(f"symmetric must be false for a mixture, got components={components}.")
        net = SymmetricPolicy(net, size, joints)
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
    statistic: Annotated[str, one_of("mean", "mode")] = "mean",
    **head: Unpack[HeadValues],
) -> ProbabilisticActor:
    """Recurrent actor: layers of an encoder, stacked GRU cells, layers, a head.

    Without ``encoder_cells`` and ``num_cells`` the encoder is one linear layer, and the head reads
    the GRU: all but the GRU is then linear.

    Reads ``observation`` ``(*B, D)``, ``is_init`` and its own hidden state under
    ``recurrent_state_actor`` ``(*B, num_layers, hidden_size)``, whose successor it writes under
    ``("next", "recurrent_state_actor")``; writes ``action`` ``(*B, J)``.

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
        statistic: what the policy does when it does not explore, ``mean`` or ``mode``.
        head: as of ``mlp_actor``.

    Raises:
        ValueError: on another statistic or initialization, or a mixture of fixed deviation.
    """
    size, joints = observation_spec["observation"].shape[-1], action_spec.shape[-1]
    out = make_head([hidden_size, *num_cells][-1], joints, components=components, **head)
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
    )
    modules = [encoder, gru]
    if residual:
        added = [gru.out_keys[0], gru.in_keys[0]]
        modules.append(TensorDictModule(torch.add, in_keys=added, out_keys=added[:1]))
    last: nn.Module = out
    if num_cells:
        last = nn.Sequential(mlp_trunk(hidden_size, num_cells, activation, initialization), out)
    modules.append(TensorDictModule(last, in_keys=gru.out_keys[:1], out_keys=list(out.keys)))
    module = TensorDictSequential(*modules)
    return _actor(module, out, statistic)


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


def recurrent_keys(module: nn.Module) -> list[NestedKey]:
    """Names of the hidden states that a network carries from step to step.

    Those that it reads, and whose successor it writes under ``("next", name)``.
    """
    reads, writes = cast(Any, module).in_keys, cast(Any, module).out_keys
    return [key for key in reads if unravel_key(("next", key)) in writes]
