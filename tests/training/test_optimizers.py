"""Optimizers and what their learning rates follow."""

import math

import pytest
import torch
from hydra.errors import HydraException
from omegaconf import OmegaConf
from torch.optim import lr_scheduler

from zfall import checkpoint
from zfall.errors import in_one_line
from zfall.training.learner import Learner
from zfall.training.optimizers import (
    KLProportionalLR,
    MuonAndAdam,
    build_optimizer,
    learning_rates,
)
from zfall.trust import trusting

SMALL = ("num_envs=4", "rollout_steps=4", "epochs=2")
LR = 5e-4  # of train.yaml


def scheduler(name: str, **values: object) -> tuple[str, str]:
    """Overrides that put one of torch's schedulers in the place of the default one."""
    own = ",".join(f"{key}:{value}" for key, value in values.items())
    return "~scheduler", f"+scheduler={{_target_:torch.optim.lr_scheduler.{name},{own}}}"


def halved(update: int) -> float:
    """Factor of a learning rate."""
    return 0.5**update


# Learning rates after the updates 1, 2 and 3.
LAMBDA = "{_target_:tests.training.test_optimizers.halved,_partial_:true}"
RATES = {
    "StepLR": ({"step_size": 2, "gamma": 0.1}, [LR, 0.1 * LR, 0.1 * LR]),
    "CosineAnnealingLR": ({"T_max": 4}, [LR * (1 + math.cos(math.pi * n / 4)) / 2 for n in (1, 2, 3)]),
    "LambdaLR": ({"lr_lambda": LAMBDA}, [LR / 2, LR / 4, LR / 8]),
    "ReduceLROnPlateau": ({"mode": "max", "patience": 0, "threshold": 1e9, "threshold_mode": "abs", "factor": 0.5},
                          [LR, LR / 2, LR / 4]),  # no reward is so much better than the first
    "OneCycleLR": ({"max_lr": LR, "total_steps": 5, "pct_start": 0.5, "anneal_strategy": "linear"}, None),
}  # fmt: skip


@pytest.mark.parametrize("name", RATES)
def test_any_scheduler_of_torch_is_stepped_once_per_update(name, compose_config):
    values, rates = RATES[name]
    learner = Learner(compose_config(*SMALL, *scheduler(name, **values)))
    found = []
    for _ in range(3):
        learner.learn(learner.collect())
        found.append(learning_rates(learner.optimizer)["learning_rate"])
    if rates is None:  # up in 1.5 steps from 1/25, then down: torch's own, stepped by hand
        one = torch.optim.Adam([torch.nn.Parameter(torch.zeros(1))], lr=LR)
        alone, rates = lr_scheduler.OneCycleLR(one, **values), []
        for _ in range(3):
            one.step()
            alone.step()
            rates.append(one.param_groups[0]["lr"])
    assert found == pytest.approx(rates)


MUON = ("optimizer._target_=zfall.training.optimizers.MuonAndAdam",)
SGD = ("optimizer._target_=torch.optim.SGD", "+optimizer.momentum=0.9")
LEARNING = {
    "Muon": MUON,
    "proportional": ("scheduler._target_=zfall.training.optimizers.KLProportionalLR",),
    "SGD": SGD,
    "lists": ("+optimizer.betas=[0.8,0.99]", *scheduler("MultiStepLR", milestones="[1,2]")),
    "Muon, StepLR": (*MUON, *scheduler("StepLR", step_size=1, gamma=0.5)),
    **{name: scheduler(name, **values) for name, (values, _) in RATES.items()},
}


@pytest.mark.parametrize("kind", LEARNING)
def test_a_training_with_any_optimizer_and_scheduler_is_resumed_exactly(
    kind, compose_config, tmp_path
):
    cfg = compose_config(*SMALL, *LEARNING[kind])
    learner = Learner(cfg)
    learner.learn(learner.collect())
    checkpoint.save(tmp_path / "last.pt", learner.state_dict())
    for _ in range(2):
        learner.learn(learner.collect())
    resumed = Learner(cfg)
    with trusting(["tests.training.test_optimizers"]):  # where the function of LambdaLR is
        resumed.load_state_dict(checkpoint.load(tmp_path / "last.pt"))
    for _ in range(2):
        resumed.learn(resumed.collect())
    assert learning_rates(resumed.optimizer) == learning_rates(learner.optimizer)
    assert all(map(torch.equal, resumed.parameters, learner.parameters))


def test_muon_steps_matrices_and_adam_the_rest():
    """Muon's steps are nearly orthogonal, of Adam's size; the first of Adam is lr in each value."""
    torch.manual_seed(0)
    matrix, vector = torch.nn.Parameter(torch.randn(8, 6)), torch.nn.Parameter(torch.randn(6))
    before = matrix.detach().clone(), vector.detach().clone()
    optimizer = MuonAndAdam([matrix, vector], lr=0.01)
    assert learning_rates(optimizer) == {"learning_rate": 0.01, "learning_rate/1": 0.01}
    (matrix.square().sum() + vector.square().sum()).backward()
    optimizer.step()
    torch.testing.assert_close(
        (vector - before[1]).abs(), torch.full((6,), 0.01), rtol=1e-3, atol=0
    )
    values = torch.linalg.svdvals(matrix.detach() - before[0]) / (0.01 * 0.2 * math.sqrt(8))
    assert (values > 0.6).all()
    assert (values < 1.3).all()
    optimizer.zero_grad()
    assert matrix.grad is None


def test_muon_alone_is_refused():
    with pytest.raises(ValueError, match="both matrices and other parameters"):
        MuonAndAdam([torch.nn.Parameter(torch.zeros(2, 2))])


class Odd:
    """A scheduler that wants what nobody knows."""

    def __init__(self, optimizer):
        pass

    def step(self, temperature):
        pass

    def state_dict(self):
        return {}

    def load_state_dict(self, state):
        pass


def test_a_scheduler_that_follows_what_nobody_knows_is_refused(compose_config):
    own = "+scheduler={_target_:tests.training.test_optimizers.Odd}"
    with pytest.raises(
        ValueError, match=r"scheduler.step must take kl, metrics .* takes temperature"
    ):
        Learner(compose_config(*SMALL, "~scheduler", own))


@pytest.mark.parametrize(("target", "factor"), [(1e-6, 1 / 1.5), (1e6, 1.5)])
def test_the_learning_rate_follows_the_divergence(compose_config, target, factor):
    """One step down where an update moves the policy by more than twice the target, or up."""
    sizes = ("num_envs=8", "rollout_steps=8")
    learner = Learner(compose_config(*sizes, f"scheduler.target_kl={target}"))
    rate = learner.optimizer.param_groups[0]["lr"]
    for update in (1, 2):
        learner.learn(learner.collect())
        assert learner.optimizer.param_groups[0]["lr"] == pytest.approx(rate * factor**update)


def test_another_optimizer_than_adam(compose_config):
    """NAdam knows nothing of ``fused``, which is there for Adam; SGD does."""
    names = {"torch.optim.NAdam": None, "torch.optim.SGD": True}
    for name, fused in names.items():
        learner = Learner(compose_config("num_envs=4", f"optimizer._target_={name}"))
        learner.learn(learner.collect())
        assert f"torch.optim.{type(learner.optimizer).__name__}" == name
        assert learner.optimizer.defaults.get("fused") is fused


@pytest.mark.parametrize(
    "values",
    [
        {"optimizer": "{_target_: torch.optim.Adam, lr: 1.0e-3, weight_decay: -1}"},
        {"optimizer": "{_target_: torch.optim.Adam, lr: 1.0e-3, betas: [2, 2]}"},
        {"optimizer": "{_target_: torch.optim.SGD, lr: 1.0e-3, nesterov: true}"},
        {"optimizer": "{_target_: builtins.list}"},
        {"scheduler": "{_target_: torch.optim.lr_scheduler.OneCycleLR, max_lr: 1.0}"},
    ],
)
def test_what_no_optimizer_or_scheduler_can_be_made_of_is_refused_with_its_key(values):
    given = {"optimizer": "{_target_: torch.optim.Adam, lr: 1.0e-3}", "scheduler": "null"} | values
    cfg = OmegaConf.create("\n".join(f"{key}: {value}" for key, value in given.items()))
    with pytest.raises((ValueError, HydraException)) as caught:
        build_optimizer(cfg, [torch.nn.Parameter(torch.zeros(2, 2))])
    assert in_one_line(caught.value).startswith(next(iter(values)))


def rate_after(kl: float, **values: float) -> float:
    """Learning rate, of 1 before, after an update with a divergence and a target of 0.01."""
    optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=1.0)
    scheduler = KLProportionalLR(optimizer, 0.01, **({"max_lr": 10.0} | values))
    scheduler.step(kl=kl)
    return optimizer.param_groups[0]["lr"]


def test_a_learning_rate_goes_by_the_ratio_of_target_and_divergence():
    assert rate_after(0.02, gain=0.5) == pytest.approx(0.5**0.5)
    assert rate_after(0.01, gain=0.5) == 1
    assert rate_after(0.005, gain=1.0, factor=3.0) == pytest.approx(2)
    assert rate_after(1.0, gain=1.0, factor=1.5) == pytest.approx(1 / 1.5)  # and no further
    assert rate_after(0.0) == 1  # nothing moved, so nothing is known
    assert rate_after(0.0001, gain=1.0, factor=2.0, max_lr=1.25) == 1.25


def test_the_divergence_of_updates_comes_to_its_target():
    """Of a system whose divergence is ``(rate / 0.003)^2 / 100``, from a rate three times as much."""
    optimizer = torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=9e-3)
    scheduler = KLProportionalLR(optimizer, 0.01)
    for _ in range(30):
        scheduler.step(kl=(optimizer.param_groups[0]["lr"] / 3e-3) ** 2 / 100)
    assert optimizer.param_groups[0]["lr"] == pytest.approx(3e-3, rel=1e-3)


@pytest.mark.parametrize("values", [{"gain": 0.0}, {"gain": 1.5}, {"factor": 1.0}])
def test_a_rule_that_would_not_correct_is_refused(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        rate_after(0.01, **values)
