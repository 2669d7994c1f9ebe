"""Proximal policy optimisation with what RLlib's has beside the clipping."""

from collections.abc import Callable
from contextlib import nullcontext
from typing import Any

import torch
from tensordict import TensorDictBase, TensorDictParams
from torch import Tensor
from torchrl.objectives import ClipPPOLoss

from zfall.losses.policy_pass import keep_policy, kept_policy, policy_pass
from zfall.values import NotNegative, Positive

_LOG_PROB = "log_prob_now"  # of the actions of a batch, by the present weights


class PenalizedPPOLoss(ClipPPOLoss):
    """``ClipPPOLoss`` with a penalty on the KL divergence and bounds on the critic's loss.

    With ``r = pi(a | o) / pi_old(a | o)``, advantage A, value V and target V*::

        loss_objective = -mean min(r A, clip(r, 1 - epsilon, 1 + epsilon) A)
        loss_kl        = beta * mean (r - 1 - log r)
        loss_critic    = critic_coeff * mean E,   E = (V - V*)^2
            value_clip c:        E = max((V - V*)^2, (V_old + clip(V - V_old, -c, c) - V*)^2)
            value_error_clip d:  E = min(E, d)

    ``r - 1 - log r`` over actions drawn from the policy of collection estimates
    ``KL(pi_old || pi)`` without bias, in value and in gradient, as ``E_old[r - 1] = 0``, for a
    mixture, whose divergence has no closed form, as for a Gaussian. It asks for nothing in the
    batch but ``action_log_prob``, and both it and its gradient vanish sample by sample at r = 1,
    where updates begin: its noise stays small beside that of the objective.

    ``beta`` is ``kl_coeff``; with a ``kl_target``, ``adapt`` moves it from update to update: times
    1.5 if the divergence was more than twice the target, by half if less than half of it. It is a
    buffer, the only state beside the networks.

    Without the three it is ``ClipPPOLoss``. The actor runs once: where the batch keeps the
    distribution of its actions, see ``policy_pass``, that is taken.

    Keys: reads the inputs of actor and critic, ``action``, ``action_log_prob``, ``advantage``,
    ``value_target`` and ``state_value``; writes as ``ClipPPOLoss``, and ``kl`` ``()``, the mean of
    ``r - 1 - log r``, and with a penalty ``loss_kl`` and ``kl_coeff`` ``()``. If the batch says
    which samples are ``mirrored`` ``(B, ...)`` bool, the divergence is that of the others: the
    policy of collection did not draw the mirrored ones.

    Args:
        actor_network, critic_network: as for ``ClipPPOLoss``, and further values of it.
        kl_coeff: weight of the penalty at the start; 0 for none.
        kl_target: divergence per update that the weight is adapted to; ``None`` keeps it.
        value_clip: largest change of a value in an update that lowers the critic's loss,
            TorchRL's ``clip_value``; RLlib's ``vf_clip_param`` until 2021.
        value_error_clip: largest squared error of a value; beyond it there is no gradient.
            RLlib's ``vf_clip_param`` since.

    Raises:
        ValueError: if a value is out of its range, or there is a target without a weight.

    Source: Schulman et al., "Proximal policy optimization algorithms", 2017, both variants at
    once; rule of adaptation and its thresholds as in RLlib's PPO (Liang et al., ICML 2018); the
    estimate of the divergence: Schulman, "Approximating KL divergence", 2020.
    """

    kl_coeff: Tensor
    out_keys: list[str]
    # Where several processes share a minibatch, means of samples can be averaged. Of other figures
    # the loss writes sums, with ``gives_sums``, and the processes take the maximum of ``largest``.
    gives_sums = False
    largest = ("max_ratio",)

    def __init__(
        self,
        actor_network: torch.nn.Module,
        critic_network: torch.nn.Module,
        *,
        kl_coeff: NotNegative = 0.0,
        kl_target: Positive | None = None,
        value_clip: Positive | None = None,
        value_error_clip: Positive | None = None,
        **values: object,
    ):
        super().__init__(actor_network, critic_network, clip_value=value_clip, **values)
        if kl_coeff < 0:
            raise ValueError(f"kl_coeff must not be negative, got {kl_coeff}.")
        if kl_target is not None and not (kl_target > 0 and kl_coeff > 0):
            raise ValueError(
                f"kl_target must be positive and go with a positive kl_coeff, got {kl_target} "
                f"with kl_coeff {kl_coeff}."
            )
        for name, bound in (("value_clip", value_clip), ("value_error_clip", value_error_clip)):
            if bound is not None and not bound > 0:
                raise ValueError(f"{name} must be positive or null, got {bound}.")
        self.kl_target, self.value_error_clip = kl_target, value_error_clip
        self.register_buffer("kl_coeff", torch.tensor(float(kl_coeff)))
        self._kl_bounds = (1e-6 * kl_coeff, 1e6 * kl_coeff)
        self.penalized = kl_coeff > 0
        self.out_keys = [*self.out_keys, "kl"]
        if self.penalized:
            self.out_keys += ["loss_kl", "kl_coeff"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Losses and figures of a batch, each ``()``."""
        policy = kept_policy(tensordict)
        if policy is None:
            policy = self._run_actor(tensordict)
        log_prob = policy.log_prob(tensordict[self.tensor_keys.action])
        here = keep_policy(tensordict, policy).set(_LOG_PROB, log_prob)
        out = super().forward(here)
        log_ratio = (log_prob - tensordict[self.tensor_keys.sample_log_prob]).unsqueeze(-1)
        divergence = log_ratio.exp() - 1 - log_ratio
        mirrored = tensordict.get("mirrored", None)
        if mirrored is None:
            divergence = divergence.mean()
        else:  # of a few sequences all may be mirrored: nothing is known of the divergence then
            drawn = (~mirrored).unsqueeze(-1)
            divergence = (divergence * drawn).sum() / drawn.sum().clamp_min(1)
        out.set("kl", divergence.detach())
        if self.gives_sums:
            out.set("ESS", _sums_of(log_ratio.detach().exp().squeeze(-1)))
        if self.penalized:
            out.set("loss_kl", self.kl_coeff * divergence)
            out.set("kl_coeff", self.kl_coeff.clone())
        return out

    @property
    def summed(self) -> dict[str, Callable[[Tensor], Tensor]]:
        """Figures by name, and what makes them of their sums over all samples."""
        return {"ESS": _effective_share, "explained_variance": _explained_variance}

    def counts(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Samples of which the divergence is the mean, if those are not all."""
        mirrored = tensordict.get("mirrored", None)
        if mirrored is None:
            return {}
        drawn = (~mirrored).sum()
        return {"kl": drawn, "loss_kl": drawn} if self.penalized else {"kl": drawn}

    def adapt(self, divergence: float) -> None:
        """Moves the weight of the penalty after an update that had so much of divergence."""
        if self.kl_target is None:
            return
        if divergence > 2 * self.kl_target:
            self.kl_coeff.mul_(1.5)
        elif divergence < self.kl_target / 2:
            self.kl_coeff.mul_(0.5)
        # Bounds from which it comes back: halved for long enough it would be 0 for good.
        self.kl_coeff.clamp_(*self._kl_bounds)

    def loss_critic(
        self, tensordict: TensorDictBase
    ) -> tuple[Tensor, Tensor | None, Tensor | None]:
        loss, *figures = super().loss_critic(tensordict)
        if self.value_error_clip is not None:
            loss = loss.clamp(max=self.critic_coeff * self.value_error_clip)
        if self.gives_sums and figures[-1] is not None:
            target = tensordict[self.tensor_keys.value_target].detach()
            error = target - tensordict[self.tensor_keys.value].detach()  # as the critic wrote it
            figures[-1] = torch.stack([_sums_of(target), _sums_of(error)])
        return loss, *figures

    def _set_in_keys(self) -> None:
        """What ``forward`` reads once advantages are known."""
        keys = [*self.actor_network.in_keys, *self.critic_network.in_keys, "action"]
        keys += ["action_log_prob", "advantage", "value_target", "state_value"]
        self._in_keys = list(dict.fromkeys(keys))

    def _run_actor(self, tensordict: TensorDictBase) -> Any:
        with (
            self.actor_network_params.to_module(self.actor_network, preserve_module_state=False)
            if self.functional
            else nullcontext()
        ):
            return policy_pass(self.actor_network, tensordict)[0]

    def _get_cur_log_prob(
        self, tensordict: TensorDictBase, params: TensorDictParams | None = None
    ) -> tuple[Tensor, Any, bool]:
        """TorchRL's place to run the actor, which has run by then."""
        return tensordict[_LOG_PROB], kept_policy(tensordict), False


def _sums_of(values: Tensor) -> Tensor:
    """Number of rows, sum and sum of squares over rows ``(3, ...)`` of values ``(n, ...)``."""
    exact = values.double()
    return torch.stack([torch.ones_like(exact), exact, exact.square()], 0).sum(1)


def _effective_share(sums: Tensor) -> Tensor:
    """Effective sample size as a share of all, from ``_sums_of`` ratios."""
    number, total, squares = sums
    return total.square() / squares / number


def _explained_variance(sums: Tensor) -> Tensor:
    """Share of the targets' variance that values explain, from ``_sums_of`` targets and errors."""
    (number, *target), (_, *error) = sums
    of_target, of_error = (
        squares / number - (total / number).square() for total, squares in (target, error)
    )
    return 1.0 - of_error / (of_target + torch.finfo(torch.float32).eps)
