"""Networks on another device than the worlds."""

from functools import partial
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase

from tests.several import config
from zfall.training import learner as learner_module
from zfall.training.learner import Learner
from zfall.training.minibatches import losses_of, rows_of
from zfall.training.transfers import Transfers

LOSSES = ["experiment=best", "num_envs=8", "rollout_steps=4", "caps=atalante", "symmetry=loss",
          "imitation=teacher"]  # fmt: skip
TRAININGS = {
    "mlp": LOSSES,
    "gru": ["num_envs=8", "rollout_steps=4", "actor=gru_mog", "critic=gru", "loss=icub",
            "caps=atalante", "symmetry=augmentation", "statistics_batches=1"],
}  # fmt: skip


def learned(overrides: list[str]) -> tuple[list[dict[str, float]], dict[str, Any]]:
    learner = Learner(config(*overrides))
    figures = [learner.learn(learner.collect()) for _ in range(2)]
    return figures, learner.state_dict()


@pytest.mark.parametrize("kind", TRAININGS)
def test_copies_to_the_networks_and_back_change_nothing(kind, monkeypatch):
    """The way of a GPU, with the CPU in its place: the same figures and weights."""
    figures, state = learned(TRAININGS[kind])
    monkeypatch.setattr(learner_module, "Transfers", partial(Transfers, copies=True))
    copied, other = learned(TRAININGS[kind])
    assert copied == figures
    for key, value in state["policy"].items():
        assert torch.equal(other["policy"][key], value)


@pytest.mark.parametrize("augmented", [False, True])
def test_losses_bring_no_tensor_of_another_device_to_a_minibatch(augmented):
    """On torch's meta device, which refuses tensors of the CPU as a GPU would. PPO's is TorchRL's."""
    more = ["symmetry=augmentation"] if augmented else []
    learner = Learner(config(*LOSSES, *more))
    data = learner._with_advantages(learner.collect())
    elsewhere, losses = Transfers("meta", copies=True), learner.losses
    elsewhere.place([learner.actor, *losses.auxiliary.values(), losses.augmentation])
    part = elsewhere.batch_there(rows_of(data, torch.arange(8)))
    if augmented:
        part = losses.augmentation(part)
        assert part["observation"].device.type == "meta"
    written = [losses_of(loss, part) for loss in losses.auxiliary.values()]
    names = {key for out in written for key in out.keys()}
    assert names >= {"loss_temporal", "loss_spatial", "loss_imitation"}
    for value in (value for out in written for value in out.values()):
        assert value.device.type == "meta"


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_device_that_is_not_there_is_refused():
    with pytest.raises(ValueError, match=r"device must be cpu, or one of 0 GPUs .* got cuda:3"):
        Learner(config("num_envs=2", "device=cuda:3"))


def test_a_network_that_is_taken_back_is_another_only_if_it_was_elsewhere():
    network = torch.nn.Linear(2, 2)
    assert Transfers("cpu").module_back(network) is network
    copied = Transfers("cpu", copies=True).module_back(network)
    assert copied is not network
    assert torch.equal(copied.weight, network.weight)


def test_the_batch_that_was_collected_stays_as_it_was(monkeypatch):
    """What learning adds to it is added to the copy."""
    monkeypatch.setattr(learner_module, "Transfers", partial(Transfers, copies=True))
    learner = Learner(config("num_envs=4", "rollout_steps=2", "minibatches=1"))
    batch: TensorDictBase = learner.collect()
    before = set(batch.keys(True, True))
    learner.learn(batch)
    assert set(batch.keys(True, True)) == before
