"""Symmetry: closed forms of linear policies, and memories that live through mirrored episodes."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn
from torch.testing import assert_close
from torchrl.data import Composite, Unbounded
from torchrl.modules import IndependentNormal, ProbabilisticActor, set_recurrent_mode

from tests.recurrent import ACTORS, SHAPES, live_through, lstm_critic, shake
from zfall.losses.symmetry import MirroredMemory, SymmetryAugmentation, SymmetryLoss
from zfall.modules.actors import mlp_actor
from zfall.modules.critics import mlp_critic
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


def in_the_mirror(shapes: dict[str, tuple]) -> dict[str, tuple]:
    return {f"{key}_mirrored": shape for key, shape in shapes.items()}


@pytest.mark.parametrize("kind", list(ACTORS))
def test_memory_in_the_mirror_is_that_of_the_mirrored_episode(mirrors, kind):
    actor, shapes = shake(ACTORS[kind](SPEC, ACTION)), SHAPES[kind]
    memory = MirroredMemory(actor, mirrors)
    batch = sequences(6, 10)
    followed = live_through(memory, batch, in_the_mirror(shapes))
    image = batch.clone().set("observation", mirrors["observation"](batch["observation"]))
    expected = live_through(actor, image, shapes)
    for key in shapes:
        assert expected[key].abs().max() > 0.01
        assert_close(followed[f"{key}_mirrored"], expected[key])


@pytest.mark.parametrize("kind", list(ACTORS))
def test_loss_of_a_recurrent_policy_follows_the_mirrored_episode(mirrors, kind):
    actor, shapes = shake(ACTORS[kind](SPEC, ACTION)), SHAPES[kind]
    loss = SymmetryLoss(actor, mirrors, coeff=1.0)
    (memory,) = loss.memories
    batch = live_through(
        memory, live_through(actor, sequences(6, 10), shapes), in_the_mirror(shapes)
    )
    image = batch.clone().set("observation", mirrors["observation"](batch["observation"]))
    image = live_through(actor, image.exclude(*shapes), shapes)
    with torch.no_grad():
        mu, there = (actor.get_dist(td.reshape(-1)).mean for td in (batch, image))
    expected = (there - mirrors["action"](mu)).square().sum(-1).mean()
    assert expected > 0.01
    later = batch[:, 3:]  # begins in the midst of episodes, with both memories
    assert_close(loss(batch)["loss_symmetry"], expected)
    parts = [loss(batch[:, :3])["loss_symmetry"] * 3, loss(later)["loss_symmetry"] * 7]
    assert_close(sum(parts) / 10, expected)


def test_all_that_an_actor_sees_is_mirrored(mirrors):
    """``mu = W (o, c)`` of two inputs; without a mirror of the second it is refused."""
    weight = torch.randn(JOINTS, OBSERVED + 1)
    net = TensorDictModule(
        lambda seen, command: Linear(weight)(torch.cat([seen, command], -1)),
        in_keys=["observation", "command"],
        out_keys=["loc", "scale"],
    )
    actor = ProbabilisticActor(net, in_keys=["loc", "scale"], distribution_class=IndependentNormal)
    with pytest.raises(ValueError, match="mirrors must have all that networks see, command"):
        SymmetryLoss(actor, mirrors)
    turn = Mirror(torch.tensor([0]), torch.tensor([-1.0]))
    loss = SymmetryLoss(actor, {**mirrors, "command": turn}, coeff=1.0)
    batch = TensorDict({"observation": torch.randn(9, OBSERVED), "command": torch.randn(9, 1)}, [9])
    there = torch.cat([mirrors["observation"](batch["observation"]), -batch["command"]], -1)
    here = torch.cat([batch["observation"], batch["command"]], -1)
    error = there @ weight.T - mirrors["action"](here @ weight.T)
    assert_close(loss(batch)["loss_symmetry"], error.square().sum(-1).mean())


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


@pytest.mark.parametrize("kind", list(ACTORS))
def test_augmented_sequences_replay_the_mirrored_episode(mirrors, kind):
    """Log-probabilities of mirrored sequences are those of a policy that lived through them."""
    actor, shapes = shake(ACTORS[kind](SPEC, ACTION)), SHAPES[kind]
    critic, of_critic = lstm_critic(SPEC), ("recurrent_state_critic_h", "recurrent_state_critic_c")
    of_critic = dict.fromkeys(of_critic, (1, 8))
    augment = SymmetryAugmentation([actor, critic], mirrors, share=0.9999)
    batch = sequences(6, 10)
    batch["observation_critic"] = batch["observation"].clone()
    batch["action"] = torch.randn(6, 10, JOINTS)
    for network, memory, of_it in zip(
        (actor, critic), augment.memories, (shapes, of_critic), strict=True
    ):
        batch = live_through(network, batch, of_it)
        batch = live_through(memory, batch, in_the_mirror(of_it))
    out = augment(batch)[:, 4:]
    image = batch.clone().set("observation", mirrors["observation"](batch["observation"]))
    image["observation_critic"] = image["observation"]
    image = live_through(actor, image.exclude(*shapes), shapes)
    image = live_through(critic, image.exclude(*of_critic), of_critic)[:, 4:]
    with torch.no_grad(), set_recurrent_mode(True):
        replayed = actor.get_dist(out.clone()).mean
        lived = actor.get_dist(image.clone()).mean
        values = [critic(td.clone())["state_value"] for td in (out, image)]
    assert_close(replayed, lived, rtol=1e-5, atol=1e-6)
    assert_close(*values, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_share_out_of_range(mirrors, share):
    with pytest.raises(ValueError, match="share must lie in"):
        SymmetryAugmentation([], mirrors, share=share)


def test_negative_weight(mirrors):
    with pytest.raises(ValueError, match="coeff must be finite and not negative, got -1"):
        SymmetryLoss(linear_actor(torch.randn(JOINTS, OBSERVED)), mirrors, coeff=-1.0)
