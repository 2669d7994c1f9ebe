"""Stacked GRU cells, fast over the short sequences that PPO learns from."""

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torchrl.modules import GRUModule

BORROWED = "memory_of"  # key of a sequence: whose memory it borrows, -1 for none

# A gradient by an argument, from that by the value: one operation for three.
sigmoid_backward, tanh_backward = torch.ops.aten.sigmoid_backward, torch.ops.aten.tanh_backward


class StackedGRU(GRUModule):
    """TorchRL's ``GRUModule``, faster on CPUs.

    One step is that of ``torch.nn.GRU``, on three keys; TorchRL takes all others of the TensorDict
    along. Over sequences ``(N, T, ...)``, in recurrent mode, TorchRL cuts and pads them where
    episodes begin, and autograd takes each of the many operations of each step by itself. Here a
    memory becomes 0 on the way where an episode begins, and each layer has one backward pass
    (``_Layer``): there is no second derivative, and no gradient to the hidden state. That must be
    there.

    Keys: reads ``in_key`` ``(*B, size)``, the hidden state ``(*B, num_layers, size)``, of a
    sequence that at its first step, and ``is_init`` ``(*B, 1)``, where it is 0 instead; writes
    ``out_key`` ``(*B, size)`` and, under ``("next", hidden)``, the hidden state after each step.
    Of sequences also ``memory_of`` ``(*B,)`` int, if it is there: the last ones may name another of
    them, the same at all steps, and are then seen step by step with its memory in the place of
    their own; -1 for their own.

    Args:
        size: width of input and layers.
        num_layers: number of layers.
        in_key, out_key: of the features.
        hidden: key of the hidden state.
    """

    lends_memory = True  # see ``zfall.modules.memory``
    gru: nn.GRU

    def __init__(self, size: int, num_layers: int, in_key: str, out_key: str, hidden: str):
        super().__init__(
            input_size=size,
            hidden_size=size,
            num_layers=num_layers,
            in_keys=[in_key, hidden, "is_init"],
            out_keys=[out_key, ("next", hidden)],
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """One step of ``(*B,)`` or, in recurrent mode, sequences ``(*B, T)``."""
        return self._sequences(tensordict) if self.recurrent_mode else self._step(tensordict)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        value, memory, begins = (tensordict[key] for key in self.in_keys)
        size = self.gru.hidden_size
        memory = torch.where(begins.unsqueeze(-1), 0.0, memory)
        memory = memory.reshape(-1, self.gru.num_layers, size).transpose(0, 1).contiguous()
        features, after = self.gru(value.reshape(-1, 1, size), memory)
        tensordict[self.out_keys[0]] = features.reshape(*tensordict.shape, size)
        after = after.transpose(0, 1)
        tensordict[self.out_keys[1]] = after.reshape(*tensordict.shape, *after.shape[1:])
        return tensordict

    def _sequences(self, tensordict: TensorDictBase) -> TensorDictBase:
        keys = [key for key in (*self.in_keys, BORROWED) if key in tensordict.keys()]
        rows = tensordict.select(*keys).reshape(-1, tensordict.shape[-1])
        value, memories, begins = (rows[key] for key in self.in_keys)
        own, lenders = len(rows), torch.empty(0, dtype=torch.int64)
        if BORROWED in keys:
            own, lenders = _lenders(rows[BORROWED])
        goes_on = (~begins[:own]).to(value.dtype).transpose(0, 1)  # (T, N, 1): steps in front
        memories = torch.where(begins[:own, 0, :, None], 0.0, memories[:own, 0])
        memories = memories.transpose(0, 1).contiguous()
        layer, states = value.transpose(0, 1).contiguous(), []
        for memory, weights in zip(memories, self.gru.all_weights, strict=True):
            layer = _Layer.apply(layer, memory, goes_on, lenders, *weights)
            states.append(layer.transpose(0, 1))
        tensordict[self.out_keys[0]] = states[-1].reshape(*tensordict.shape, self.gru.hidden_size)
        after = torch.stack(states, 2)
        tensordict[self.out_keys[1]] = after.reshape(*tensordict.shape, *after.shape[2:])
        return tensordict


def borrow_memory(sequences: TensorDictBase) -> TensorDictBase:
    """Sequences ``(N, T)`` that are seen, step by step, with the memory of those of a batch.

    The n-th borrows from the n-th of what goes through the network in front of them, see
    ``together``: the first batch that has memories of its own.
    """
    rows = torch.arange(len(sequences))[:, None]
    return sequences.copy().set(BORROWED, rows.expand(sequences.shape))


def together(
    batches: Sequence[TensorDictBase], keys: Iterable[NestedKey]
) -> tuple[TensorDictBase, list[slice]]:
    """Several batches in one, in their order, but those that borrow memory last.

    Args:
        batches: each ``(M, ...)``.
        keys: of a network's inputs.

    Returns:
        All of them, and where each lies in it.
    """
    keys = list(keys)
    borrows = [BORROWED in batch.keys() for batch in batches]
    order = sorted(range(len(batches)), key=lambda i: borrows[i])
    parts = [batches[i].select(*keys) for i in order]
    if any(borrows):
        for part, i in zip(parts, order, strict=True):
            own = torch.full(part.shape, -1)
            part[BORROWED] = batches[i][BORROWED] if borrows[i] else own
    places, start = [slice(0)] * len(batches), 0
    for i in order:
        places[i] = slice(start, start + len(batches[i]))
        start = places[i].stop
    return (torch.cat(parts) if len(parts) > 1 else parts[0]), places


def _lenders(memory_of: Tensor) -> tuple[int, Tensor]:
    """How many sequences have a memory of their own, and whose the others have ``(M,)``."""
    named = memory_of[:, 0]
    own = int((named < 0).sum())
    lenders = named[own:]
    same = (memory_of == named[:, None]).all()
    if not (same and (lenders >= 0).all() and (lenders < own).all()):
        raise ValueError(
            "memory_of must be the same at all steps, -1 in front, and of the last sequences one "
            f"of the {own} in front, got {named.tolist()} at the first step."
        )
    return own, lenders


class _Layer(torch.autograd.Function):
    """One GRU layer over sequences, as ``torch.nn.GRU`` defines it::

        r, z = sigmoid(W x + b + U h + c),   n = tanh(W x + b + r (U h + c)),   h' = n + z (h - n)

    ``inputs`` ``(T, N + M, D)``, ``memory`` ``(N, H)`` before the first step, ``goes_on``
    ``(T, N, 1)``, 0 where a later step begins with h = 0, else 1, ``lenders`` ``(M,)`` int, from
    whose h the last M rows get their h', which nobody goes on from; -> the hidden state after each
    step ``(T, N + M, H)``. What does not depend on the step before is done for all steps at once,
    forwards and backwards. The memory gets no gradient.
    """

    @staticmethod
    def forward(
        ctx: Any,
        inputs: Tensor,
        memory: Tensor,
        goes_on: Tensor,
        lenders: Tensor,
        weight_in: Tensor,
        weight: Tensor,
        bias_in: Tensor,
        bias: Tensor,
    ) -> Tensor:
        size, own = weight.shape[1], len(memory)
        gates = nn.functional.linear(inputs, weight_in, bias_in)  # (T, N + M, 3 H): r, z, n
        recalled = torch.empty_like(gates)  # U h + c
        states = inputs.new_empty(*inputs.shape[:2], size)
        before = torch.empty_like(states)  # h
        before[0, :own] = memory
        both, new = gates.split([2 * size, size], 2)
        of_both, of_new = recalled.split([2 * size, size], 2)
        parts = (both, *both.chunk(2, 2), new, recalled, of_both, of_new, before, states)
        # Views of all steps at once: one by one they take as long as the arithmetic of a step.
        steps = zip(*(part[:, :own].unbind() for part in parts), goes_on.unbind(), strict=True)
        last, columns = memory, weight.t()
        for t, (both, reset, keep, new, recall, of_both, of_new, h, state, on) in enumerate(steps):
            if t:
                torch.mul(last, on, out=h)
            torch.addmm(bias, h, columns, out=recall)
            both.add_(of_both).sigmoid_()
            new.addcmul_(reset, of_new).tanh_()
            last = torch.lerp(new, h, keep, out=state)
        if len(lenders):
            for part in (recalled, before):
                part[:, own:] = part[:, lenders]
            both, reset, keep, new, _, of_both, of_new, h, state = (x[:, own:] for x in parts)
            both.add_(of_both).sigmoid_()
            new.addcmul_(reset, of_new).tanh_()
            torch.lerp(new, h, keep, out=state)
        ctx.save_for_backward(inputs, goes_on, lenders, weight_in, weight, gates, recalled, before)
        return states

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        inputs, goes_on, lenders, weight_in, weight, gates, recalled, before = ctx.saved_tensors
        size, own = weight.shape[1], goes_on.shape[1]
        reset, keep, new = gates.split(size, 2)
        # By how much a state moves with the arguments of r and z, and with what n recalls.
        slopes = torch.empty_like(gates)
        of_reset, of_keep, of_recall = slopes.split(size, 2)
        of_new = tanh_backward(1 - keep, new)
        torch.mul(of_new, reset, out=of_recall)
        by_reset = of_new * recalled[..., 2 * size :]
        sigmoid_backward.grad_input(by_reset, reset, grad_input=of_reset)
        sigmoid_backward.grad_input(before - new, keep, grad_input=of_keep)
        grads = grad.clone(memory_format=torch.contiguous_format)  # by the states, in the end
        by_recalled = torch.empty_like(slopes)
        if len(lenders):
            borrowed = grads[:, own:]
            by_borrowed = by_recalled[:, own:]
            torch.mul(borrowed.repeat(1, 1, 3), slopes[:, own:], out=by_borrowed)
            by_memory = (by_borrowed @ weight).addcmul_(borrowed, keep[:, own:])
            by_memory = by_memory[1:] * goes_on[1:, lenders]
            grads[:-1].index_add_(1, lenders, by_memory)
        passed = before.new_empty(own, size)
        owned = (grads, *slopes.split(size, 2), by_recalled, *by_recalled.split(size, 2))
        parts = [part[:, :own] for part in owned]
        parts += [keep[:, :own] * goes_on, goes_on]
        steps = list(zip(*(part.unbind() for part in parts), strict=True))
        for step, earlier in zip(reversed(steps), [*reversed(steps[:-1]), None], strict=True):
            here, of_reset, of_keep, of_recall, by, by_reset, by_keep, by_recall, kept, on = step
            # Gate by gate: all at once are so large that a second thread is asked, and waited for.
            torch.mul(here, of_reset, out=by_reset)
            torch.mul(here, of_keep, out=by_keep)
            torch.mul(here, of_recall, out=by_recall)
            if earlier is not None:
                torch.mm(by, weight, out=passed)
                earlier[0].addcmul_(here, kept).addcmul_(passed, on)
        rows = by_recalled.flatten(0, 1)  # (T (N + M), 3 H)
        grad_weight, grad_bias = rows.t() @ before.flatten(0, 1), rows.sum(0)
        # From here on rows are by W x + b, which differs in n: r does not scale it.
        torch.mul(grads, of_new, out=by_recalled[..., 2 * size :])
        grad_weight_in, grad_bias_in = rows.t() @ inputs.flatten(0, 1), rows.sum(0)
        grad_inputs = (rows @ weight_in).view_as(inputs)
        weights = (grad_weight_in, grad_weight, grad_bias_in, grad_bias)
        return grad_inputs, None, None, None, *weights
