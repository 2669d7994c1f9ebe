"""Networks with a memory of any kind: one hidden state or several, of any shape.

What is said here holds for TorchRL's ``GRUModule`` and ``LSTMModule``, for several of them in a
row, and for modules like them: hidden states are keys that a network reads, and whose successors
it writes under ``("next", key)``, see ``recurrent_keys``.
"""

import math
from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.envs import TensorDictPrimer, Transform, TransformedEnv
from torchrl.modules import set_recurrent_mode
from torchrl.modules.utils import get_primers_from_module

from zfall.modules.actors import recurrent_keys


def parts_of(network: Any) -> list[Any]:
    """The modules of a network in the order in which they run, those within others taken out."""
    if not isinstance(network, TensorDictSequential):
        return [network]
    return [part for module in cast(Any, network) for part in parts_of(module)]


def memory_part(network: Any) -> TensorDictSequential:
    """The modules from which the memory follows: nothing is drawn or put out."""
    needed = {unravel_key(("next", key)) for key in recurrent_keys(network)}
    chosen: list[Any] = []
    for part in reversed(parts_of(network)):
        if needed & {*part.out_keys}:
            chosen.insert(0, part)
            needed |= {*part.in_keys}
    return TensorDictSequential(*chosen)


def lends_memory(network: nn.Module) -> bool:
    """Whether all the memory of a network is of modules with ``lends_memory``, as ``StackedGRU``.

    In recurrent mode these write the memory after every step, where TorchRL's write that after the
    last one alone; and sequences may borrow it, see ``zfall.modules.gru.borrow_memory``.
    """
    lenders = (part for part in network.modules() if getattr(part, "lends_memory", False))
    lent = {key for part in lenders for key in recurrent_keys(part)}
    return bool(lent) and lent == {*recurrent_keys(network)}


def memory_before(
    network: Any, sequences: TensorDictBase, passed: TensorDictBase | None = None
) -> dict[NestedKey, Tensor]:
    """The memory in front of each step of sequences, with its gradient.

    It begins with what is stored for the first step, and anew where an episode begins.

    Args:
        network: with a memory.
        sequences: ``(N, T)``, with what the network reads.
        passed: what the network made of them in recurrent mode, should it be known.

    Returns:
        By hidden state ``(N, T, ...)``.
    """
    keys = recurrent_keys(network)
    if lends_memory(network):
        after = _in_one_pass(network, sequences) if passed is None else passed
        return {
            key: torch.cat([sequences[key][:, :1], after["next", key][:, :-1]], 1) for key in keys
        }
    steps = _step_by_step(network, sequences)
    return {key: torch.stack([step[key] for step in steps[:-1]], 1) for key in keys}


def memory_after(network: Any, sequences: TensorDictBase) -> dict[NestedKey, Tensor]:
    """The memory after the last step of sequences ``(N, T)``, by hidden state ``(N, ...)``."""
    keys = recurrent_keys(network)
    if lends_memory(network):
        after = _in_one_pass(network, sequences)
        return {key: after["next", key][:, -1] for key in keys}
    return _step_by_step(network, sequences)[-1]


def _in_one_pass(network: Any, sequences: TensorDictBase) -> TensorDictBase:
    with set_recurrent_mode(True):
        return cast(TensorDictBase, network(sequences.select(*network.in_keys)))


def _step_by_step(network: Any, sequences: TensorDictBase) -> list[dict[NestedKey, Tensor]]:
    """The memory in front of each step, and after the last."""
    keys, part = recurrent_keys(network), memory_part(network)
    memory = {key: sequences[key][:, 0] for key in keys}
    found = []
    begins = sequences["is_init"].unbind(1)
    for number, step in enumerate(sequences.select(*part.in_keys).unbind(1)):
        if number:
            memory = {
                key: rows_where(begins[number], step[key], value) for key, value in memory.items()
            }
        found.append(memory)
        with set_recurrent_mode(False):
            after = part(step.copy().update(memory))
        memory = {key: after["next", key] for key in keys}
    return [*found, memory]


class WithoutMemory(TensorDictModuleBase):
    """A network whose memory begins anew in every step: what it does without knowing the past.

    Keys: those of the network; what it remembers is read by nobody.

    Args:
        network: with a memory, not in recurrent mode.

    Raises:
        ValueError: if it has no memory, or one that does not begin with one number.
    """

    def __init__(self, network: nn.Module):
        super().__init__()
        if not recurrent_keys(network):
            raise ValueError("network must have a memory to be without it, got one that has none.")
        self.network = network
        self.in_keys, self.out_keys = cast(Any, network).in_keys, cast(Any, network).out_keys
        self._beginning = {key: value for key, (_, value) in memory_beginning(network).items()}

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """One step of ``(*B,)``."""
        for key, value in self._beginning.items():
            tensordict[key] = torch.full_like(tensordict[key], value)
        return cast(TensorDictBase, self.network(tensordict))


def rows_where(rows: Tensor, there: Tensor, elsewhere: Tensor) -> Tensor:
    """``torch.where`` by rows ``(N,)`` or ``(N, 1)`` bool of values ``(N, ...)``."""
    return torch.where(rows.reshape(-1, *[1] * (elsewhere.dim() - 1)), there, elsewhere)


def memory_primer(network: Any, place: str) -> Transform:
    """The transform by which an env carries the memory of a network.

    Args:
        network: with a memory.
        place: what to call it, ``actor`` or ``critic``.

    Raises:
        ValueError: if none of its modules says how its memory begins, or it does not go on.
    """
    known = {key for primer in _primers_of(network) for key in primer.primers.keys(True, True)}
    for key in recurrent_keys(network):
        if key not in known:
            raise ValueError(
                f"{place} must say how its memory {key} begins, by a module with "
                "make_tensordict_primer, as TorchRL's LSTMModule has it; got none."
            )
    reads, writes = {*network.in_keys}, {*network.out_keys, *recurrent_keys(network)}
    for key in known & reads - writes:
        raise ValueError(
            f"{place} must write what follows its memory {key}, under "
            f"{unravel_key(('next', key))} among its out_keys; got none."
        )
    return cast(Transform, get_primers_from_module(network))


def carry_memory(env: TransformedEnv, actor: Any) -> None:
    """Lets an env carry the memory of a policy; one without, or that is carried, changes nothing.

    Raises:
        ValueError: as ``memory_primer``.
    """
    if not set(recurrent_keys(actor)) <= set(env.observation_spec.keys(True, True)):
        env.append_transform(memory_primer(actor, "actor"))


def memory_beginning(network: nn.Module) -> dict[NestedKey, tuple[TensorSpec, float]]:
    """Of each hidden state the spec, without batch axes, and the value of all its numbers.

    Raises:
        ValueError: if one begins with something else than one number.
    """
    begins: dict[NestedKey, tuple[TensorSpec, float]] = {}
    for primer in _primers_of(network):
        for key, spec in primer.primers.items(True, True):
            whole = primer.single_default_value or primer.random
            value = None if whole else primer.default_value[key]
            begins[key] = spec, math.nan if value is None or callable(value) else float(value)
    for key in recurrent_keys(network):
        if key not in begins or math.isnan(begins[key][1]):
            raise ValueError(
                f"the memory {key} must begin with one number, which its primer gives "
                "(default_value), to be put back, mirrored or exported; got none."
            )
    return {key: begins[key] for key in recurrent_keys(network)}


def _primers_of(network: nn.Module) -> list[TensorDictPrimer]:
    made = (getattr(part, "make_tensordict_primer", None) for part in network.modules())
    return [make() for make in made if make is not None]
