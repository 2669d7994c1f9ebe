"""Stacked GRU cells, fast over the short sequences that PPO learns from."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torchrl.modules import GRUModule


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

    Args:
        size: width of input and layers.
        num_layers: number of layers.
        in_key, out_key: of the features.
        hidden: key of the hidden state.
    """

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
        rows = tensordict.select(*self.in_keys).reshape(-1, tensordict.shape[-1])
        value, memories, begins = (rows[key] for key in self.in_keys)
        goes_on = (~begins).to(value.dtype).transpose(0, 1)  # (T, N, 1): steps in front
        memories = torch.where(begins[:, 0, :, None], 0.0, memories[:, 0])
        memories = memories.transpose(0, 1).contiguous()
        layer, states = value.transpose(0, 1).contiguous(), []
        for memory, weights in zip(memories, self.gru.all_weights, strict=True):
            layer = _Layer.apply(layer, memory, goes_on, *weights)
            states.append(layer.transpose(0, 1))
        tensordict[self.out_keys[0]] = states[-1].reshape(*tensordict.shape, self.gru.hidden_size)
        after = torch.stack(states, 2)
        tensordict[self.out_keys[1]] = after.reshape(*tensordict.shape, *after.shape[2:])
        return tensordict


class _Layer(torch.autograd.Function):
    """One GRU layer over sequences, as ``torch.nn.GRU`` defines it::

        r, z = sigmoid(W x + b + U h + c),   n = tanh(W x + b + r (U h + c)),   h' = n + z (h - n)

    ``inputs`` ``(T, N, D)``, ``memory`` ``(N, H)`` before the first step, ``goes_on``
    ``(T, N, 1)``, 0 where a later step begins with h = 0, else 1; -> the hidden state after each
    step ``(T, N, H)``. What does not depend on the step before is done for all steps at once,
    forwards and backwards. The memory gets no gradient.
    """

    @staticmethod
    def forward(
        ctx: Any,
        inputs: Tensor,
        memory: Tensor,
        goes_on: Tensor,
        weight_in: Tensor,
        weight: Tensor,
        bias_in: Tensor,
        bias: Tensor,
    ) -> Tensor:
        size = weight.shape[1]
        gates = nn.functional.linear(inputs, weight_in, bias_in)  # (T, N, 3 H): r, z, n
        recalled = torch.empty_like(gates)  # U h + c
        states = inputs.new_empty(*inputs.shape[:2], size)
        both, new = gates.split([2 * size, size], 2)
        of_both, of_new = recalled.split([2 * size, size], 2)
        parts = (both, *both.chunk(2, 2), new, recalled, of_both, of_new, states, goes_on)
        # Views of all steps at once: one by one they take as long as the arithmetic of a step.
        steps = zip(*(part.unbind() for part in parts), strict=True)
        before, columns = memory, weight.t()
        for t, (both, reset, keep, new, recall, of_both, of_new, state, on) in enumerate(steps):
            if t:
                before = before * on
            torch.addmm(bias, before, columns, out=recall)
            both.add_(of_both).sigmoid_()
            new.addcmul_(reset, of_new).tanh_()
            before = torch.lerp(new, before, keep, out=state)
        ctx.save_for_backward(inputs, memory, goes_on, weight_in, weight, gates, recalled, states)
        return states

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        inputs, memory, goes_on, weight_in, weight, gates, recalled, states = ctx.saved_tensors
        size = weight.shape[1]
        before = torch.empty_like(states)
        before[0] = memory
        torch.mul(states[:-1], goes_on[1:], out=before[1:])
        reset, keep, new = gates.split(size, 2)
        # By how much a state moves with the arguments of r and z, and with what n recalls.
        slopes = torch.empty_like(gates)
        of_reset, of_keep, of_recall = slopes.split(size, 2)
        of_new = (1 - keep).mul_(1 - new.square())
        torch.mul(of_new, reset, out=of_recall)
        torch.mul(of_recall, 1 - reset, out=of_reset).mul_(recalled[..., 2 * size :])
        torch.mul(before - new, keep, out=of_keep).mul_(1 - keep)
        grads = grad.clone(memory_format=torch.contiguous_format)  # by the states, in the end
        by_recalled, passed = torch.empty_like(slopes), torch.empty_like(memory)
        parts = (grads, keep * goes_on, goes_on, by_recalled, *slopes.split(size, 2))
        steps = list(zip(*(x.unbind() for x in (*parts, *by_recalled.split(size, 2))), strict=True))
        for step, earlier in zip(reversed(steps), [*reversed(steps[:-1]), None], strict=True):
            here, kept, on, by, of_reset, of_keep, of_recall, by_reset, by_keep, by_recall = step
            # Gate by gate: all at once are so large that a second thread is asked, and waited for.
            torch.mul(here, of_reset, out=by_reset)
            torch.mul(here, of_keep, out=by_keep)
            torch.mul(here, of_recall, out=by_recall)
            if earlier is not None:
                torch.mm(by, weight, out=passed)
                earlier[0].addcmul_(here, kept).addcmul_(passed, on)
        rows = by_recalled.flatten(0, 1)  # (T N, 3 H)
        grad_weight, grad_bias = rows.t() @ before.flatten(0, 1), rows.sum(0)
        # From here on rows are by W x + b, which differs in n: r does not scale it.
        torch.mul(grads, of_new, out=by_recalled[..., 2 * size :])
        grad_weight_in, grad_bias_in = rows.t() @ inputs.flatten(0, 1), rows.sum(0)
        grad_inputs = (rows @ weight_in).view_as(inputs)
        return grad_inputs, None, None, grad_weight_in, grad_weight, grad_bias_in, grad_bias
