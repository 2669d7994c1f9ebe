"""Stacked GRU cells, fast over the short sequences that PPO learns from."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.autograd.function import once_differentiable
from torchrl.modules import GRUModule


class StackedGRU(GRUModule):
    """TorchRL's ``GRUModule``, with a faster pass over sequences on CPUs.

    One step is TorchRL's, with ``torch.nn.GRU``. Over sequences ``(N, T, ...)``, in recurrent mode,
    TorchRL cuts and pads them where episodes begin, and autograd takes each of the many operations
    of each step by itself. Here a memory that begins anew takes the place of the old one on the
    way, and each layer has one backward pass (``_Layer``).

    Keys: reads ``in_key`` ``(*B, size)``, the hidden state ``(*B, num_layers, size)`` and
    ``is_init`` ``(*B, 1)``; writes ``out_key`` ``(*B, size)`` and, under ``("next", hidden)``, the
    hidden state after each step.

    Args:
        size: width of input and layers.
        num_layers: number of layers.
        in_key, out_key: of the features.
        hidden: of the hidden state. Stored ones count at the first step of a sequence and where
            an episode begins.
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
        if not self.recurrent_mode:
            return super().forward(tensordict)
        shape = tensordict.shape
        value, memories, begins = (
            tensordict[key].reshape(-1, shape[-1], *tensordict[key].shape[len(shape) :])
            for key in self.in_keys
        )
        begins = begins.transpose(0, 1).clone()  # (T, N, 1): steps in front
        begins[0] = True
        memories = (memories * begins.transpose(0, 1)[..., None]).permute(2, 1, 0, 3).contiguous()
        goes_on = (~begins).to(value.dtype)
        layer, states = value.transpose(0, 1).contiguous(), []
        for index, memory in enumerate(memories):
            names = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
            weights = [getattr(self.gru, f"{name}_l{index}") for name in names]
            layer = _Layer.apply(layer, memory, goes_on, *weights)
            states.append(layer.transpose(0, 1))
        after = torch.stack(states, 2)
        tensordict[self.out_keys[0]] = states[-1].reshape(*shape, -1)
        tensordict[self.out_keys[1]] = after.reshape(*shape, *after.shape[2:])
        return tensordict


class _Layer(torch.autograd.Function):
    """One GRU layer over sequences, as ``torch.nn.GRU`` defines it::

        r, z = sigmoid(W x + b + U h + c),   n = tanh(W x + b + r (U h + c)),   h' = n + z (h - n)

    ``inputs`` ``(T, N, D)``; ``goes_on`` ``(T, N, 1)`` is 0 where the memory begins anew, with what
    ``memories`` ``(T, N, H)`` hold, which are 0 elsewhere; -> the hidden state after each step
    ``(T, N, H)``. What does not depend on the step before is done for all steps at once, forwards
    and backwards. Memories get no gradient.
    """

    @staticmethod
    def forward(
        ctx: Any,
        inputs: Tensor,
        memories: Tensor,
        goes_on: Tensor,
        weight_in: Tensor,
        weight: Tensor,
        bias_in: Tensor,
        bias: Tensor,
    ) -> Tensor:
        size = weight.shape[1]
        gates = nn.functional.linear(inputs, weight_in, bias_in)  # (T, N, 3 H): r, z, n
        recurrent = torch.empty_like(gates)
        states, before = torch.empty_like(memories), memories[0]
        for t, (gate, again) in enumerate(zip(gates, recurrent, strict=True)):
            if t:
                before = torch.addcmul(memories[t], states[t - 1], goes_on[t])
            torch.addmm(bias, before, weight.t(), out=again)
            gate[:, : 2 * size].add_(again[:, : 2 * size]).sigmoid_()
            reset, keep, new = gate.split(size, 1)
            new.addcmul_(reset, again[:, 2 * size :]).tanh_()
            torch.lerp(new, before, keep, out=states[t])
        ctx.save_for_backward(
            inputs, memories, goes_on, weight_in, weight, gates, recurrent, states
        )
        return states

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        inputs, memories, goes_on, weight_in, weight, gates, recurrent, states = ctx.saved_tensors
        size = weight.shape[1]
        before = torch.addcmul(memories, states.roll(1, 0), goes_on)
        reset, keep, new = gates.split(size, 2)
        # By how much the argument of each gate moves the state.
        slopes = torch.empty_like(gates)
        of_reset, of_keep, of_again = slopes.split(size, 2)
        of_new = (1 - keep).mul_(1 - new.square())
        torch.mul(of_new, reset, out=of_again)
        torch.mul(of_again, 1 - reset, out=of_reset).mul_(recurrent[..., 2 * size :])
        torch.mul(before - new, keep, out=of_keep).mul_(1 - keep)
        kept = keep * goes_on  # nothing goes back over the beginning of an episode
        grads, back = grad.clone(), torch.empty_like(slopes)
        by_gate, slopes = back.unflatten(2, (3, size)), slopes.unflatten(2, (3, size))
        for t in reversed(range(len(grads))):
            torch.mul(grads[t].unsqueeze(1), slopes[t], out=by_gate[t])
            if t:
                grads[t - 1].addcmul_(grads[t], kept[t]).addcmul_(back[t] @ weight, goes_on[t])
        rows = back.flatten(0, 1)  # (T N, 3 H)
        grad_weight, grad_bias = rows.t() @ before.flatten(0, 1), rows.sum(0)
        torch.mul(grads, of_new, out=back[..., 2 * size :])  # its own input is not reset
        grad_weight_in, grad_bias_in = rows.t() @ inputs.flatten(0, 1), rows.sum(0)
        grad_inputs = (rows @ weight_in).view_as(inputs) if ctx.needs_input_grad[0] else None
        return grad_inputs, None, None, grad_weight_in, grad_weight, grad_bias_in, grad_bias
