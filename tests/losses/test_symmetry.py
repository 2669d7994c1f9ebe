"""Symmetry: closed forms of linear policies, and memories that live through mirrored episodes."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.modules import IndependentNormal, ProbabilisticActor, set_recurrent_mode

from zfall.losses.symmetry import MirroredMemory, SymmetryAugmentation, SymmetryLoss
from zfall.modules.actors import gru_actor, mlp_actor
from zfall.modules.critics import gru_critic, mlp_critic
from zfall.modules.mirror import Mirror

OBSERVED, JOINTS = 4, 2
SPEC = Composite(
    {"observation": Unbounded((1, OBSERVED)), "observation_critic": Unbounded((1, OBSERVED))},
    shape=(1,),
)
ACTION = Unbounded((1, JOINTS))


@pytest.fixture
def mirrors() -> dict[str, Mirror]:
    """Swaps the first two components; the third changes its sign; the joints swap and turn."""
    observation = Mirror(torch.tensor([1, 0, 2, 3]), torch.tensor([1.0, 1.0, -1.0, 1.0]))
    action = Mirror(torch.tensor([1, 0]), torch.tensor([-1.0, -1.0]))
    return {"observation": observation, "observation_critic": observation, "action": action}


class Linear(nn.Module):
    def __init__(self, weight: torch.Tensor):
        super().__init__()
        self.weight = nn.Parameter(weight)

    def forward(self, observation: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        loc = observation @ self.weight.T
        return loc, torch.full_like(loc, 0.3)


def linear_actor(weight: torch.Tensor) -> ProbabilisticActor:
    module = TensorDictModule(Linear(weight), in_keys=["observation"], out_keys=["loc", "scale"])
    return ProbabilisticActor(
        module, in_keys=["loc", "scale"], distribution_class=IndependentNormal
    )


def test_loss_of_a_linear_policy_is_its_commutator(mirrors):
    """``mu = W o``: the error is ``(W M_o - M_a W) o``, whose mean square is its squared norm."""
    weight = torch.randn(JOINTS, OBSERVED)
    swap = torch.tensor([[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]])
    turn = torch.tensor([[0.0, -1.0], [-1.0, 0.0]])
    commutator = weight @ swap - turn @ weight
    loss = SymmetryLoss(linear_actor(weight), mirrors, coeff=0.5)
    batch = TensorDict({"observation": torch.randn(200_000, OBSERVED)}, [200_000])
    expected = 0.5 * commutator.square().sum().item()
    assert loss(batch)["loss_symmetry"].item() == pytest.approx(expected, rel=0.02)


def test_loss_of_a_symmetric_policy_is_zero(mirrors):
    weight = torch.tensor([[0.3, -0.7, 0.2, 0.5], [0.7, -0.3, 0.2, -0.5]])
    loss = SymmetryLoss(linear_actor(weight), mirrors)
    batch = TensorDict({"observation": torch.randn(50, OBSERVED)}, [50])
    assert loss(batch)["loss_symmetry"].item() == pytest.approx(0.0, abs=1e-12)


def sequences(rows: int, steps: int) -> TensorDict:
    """An episode's end somewhere in every other row."""
    is_init = torch.zeros(rows, steps, 1, dtype=torch.bool)
    is_init[::2, steps // 2] = True
    return TensorDict(
        {"observation": torch.randn(rows, steps, OBSERVED), "is_init": is_init}, [rows, steps]
    )


def live_through(network, batch: TensorDict, key: str) -> TensorDict:
    """The batch step by step, with the hidden state of each step in it, zero at a reset."""
    state, steps = torch.zeros(len(batch), 2, 8), []
    for step in batch.unbind(1):
        state = torch.where(step["is_init"][..., None], 0.0, state)
        step = step.clone().set(key, state)
        state = network(step.clone())["next", key]
        steps.append(step)
    return torch.stack(steps, 1)


def test_memory_in_the_mirror_is_that_of_the_mirrored_episode(mirrors):
    actor = gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2)
    memory = MirroredMemory(actor, mirrors["observation"])
    batch = sequences(6, 10)
    followed = live_through(memory, batch, memory.key)[memory.key]
    image = batch.clone().set("observation", mirrors["observation"](batch["observation"]))
    expected = live_through(actor, image, "recurrent_state_actor")["recurrent_state_actor"]
    assert followed.abs().max() > 0.01
    assert_close(followed, expected)


def test_loss_of_a_recurrent_policy_follows_the_mirrored_episode(mirrors):
    actor = gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2, components=0)
    nn.init.orthogonal_(actor[0][-1].module.mean.weight)  # not near zero, as at the start
    loss = SymmetryLoss(actor, mirrors, coeff=1.0)
    (memory,) = loss.memories
    batch = sequences(6, 10)
    batch = live_through(memory, live_through(actor, batch, memory.hidden), memory.key)
    image = batch.clone().set("observation", mirrors["observation"](batch["observation"]))
    image = live_through(actor, image.exclude(memory.hidden), memory.hidden)
    with torch.no_grad():
        mu, there = (actor.get_dist(td.reshape(-1)).mean for td in (batch, image))
    expected = (there - mirrors["action"](mu)).square().sum(-1).mean()
    assert expected > 0.01
    later = batch[:, 3:]  # begins in the midst of episodes, with both memories
    assert_close(loss(batch)["loss_symmetry"], expected)
    parts = [loss(batch[:, :3])["loss_symmetry"] * 3, loss(later)["loss_symmetry"] * 7]
    assert_close(sum(parts) / 10, expected)


def test_augmentation_mirrors_a_share_of_the_samples_and_nothing_else(mirrors):
    actor = mlp_actor(SPEC, ACTION, num_cells=[8])
    augment = SymmetryAugmentation([actor, mlp_critic(SPEC, num_cells=[8])], mirrors, share=0.25)
    rows = 20_000
    batch = TensorDict(
        {
            "observation": torch.randn(rows, OBSERVED),
            "observation_critic": torch.randn(rows, OBSERVED),
            "action": torch.randn(rows, JOINTS),
            "action_log_prob": torch.randn(rows),
            "advantage": torch.randn(rows, 1),
            "observation_neighbour": torch.randn(rows, OBSERVED),
            "next": {"observation": torch.randn(rows, OBSERVED)},
        },
        [rows],
    )
    before = batch.clone()
    out = augment(batch)
    assert (batch == before).all()
    changed = (out["observation"] != batch["observation"]).any(-1)
    assert changed.float().mean().item() == pytest.approx(0.25, abs=0.02)
    for key in (*mirrors, ("next", "observation")):
        mirror = mirrors[key if isinstance(key, str) else key[1]]
        assert_close(out[key][changed], mirror(batch[key])[changed])
        assert_close(out[key][~changed], batch[key][~changed])
    near, mirror = "observation_neighbour", mirrors["observation"]
    assert_close(out[near][changed], mirror(batch[near])[changed])
    for key in ("action_log_prob", "advantage"):
        assert_close(out[key], batch[key])


def test_augmented_sequences_replay_the_mirrored_episode(mirrors):
    """Log-probabilities of mirrored sequences are those of a policy that lived through them."""
    actor = gru_actor(SPEC, ACTION, hidden_size=8, num_layers=2)
    critic = gru_critic(SPEC, hidden_size=8, num_layers=2)
    augment = SymmetryAugmentation([actor, critic], mirrors, share=0.9999)
    memory, of_critic = augment.memories
    batch = sequences(6, 10)
    batch["observation_critic"] = batch["observation"].clone()
    batch["action"] = torch.randn(6, 10, JOINTS)
    for network, key in (
        (actor, memory.hidden),
        (memory, memory.key),
        (critic, of_critic.hidden),
        (of_critic, of_critic.key),
    ):
        batch = live_through(network, batch, key)
    out = augment(batch)[:, 4:]
    image = batch.clone().set("observation", mirrors["observation"](batch["observation"]))
    image = live_through(actor, image.exclude(memory.hidden), memory.hidden)[:, 4:]
    with torch.no_grad(), set_recurrent_mode(True):
        replayed = actor.get_dist(out.clone()).mean
        lived = actor.get_dist(image.clone()).mean
    assert_close(replayed, lived, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_share_out_of_range(mirrors, share):
    with pytest.raises(ValueError, match="share must lie in"):
        SymmetryAugmentation([], mirrors, share=share)


def test_negative_weight(mirrors):
    with pytest.raises(ValueError, match="coeff must be finite and not negative, got -1"):
        SymmetryLoss(linear_actor(torch.randn(JOINTS, OBSERVED)), mirrors, coeff=-1.0)
