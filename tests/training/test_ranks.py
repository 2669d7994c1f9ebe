"""One training in several processes: the same as in one."""

import socket
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from tests.several import config, in_each
from zfall.modules.normalization import merged_moments, moments_of
from zfall.training import learner as learner_module
from zfall.training.draws import Draw, DrawnTogether
from zfall.training.learner import Learner
from zfall.training.meeting import ranks_of
from zfall.training.metrics import batch_metrics
from zfall.training.ranks import Piece, Ranks
from zfall.training.shares import PartOfMinibatch
from zfall.training.transfers import Transfers

BUSY = ["env.transforms.push.interval=[0.0,0.1]", "env.transforms.limit.seconds=0.3"]
TRAININGS = {
    "mlp": (2, ["experiment=best", "num_envs=16", "rollout_steps=6", "groups=2", "caps=atalante",
                "symmetry=loss", "imitation=teacher", *BUSY]),
    "gru": (2, ["num_envs=16", "rollout_steps=8", "groups=2", "actor=gru_mog", "critic=gru",
                "loss=icub", "caps=atalante", "symmetry=augmentation", "burn_in=2", *BUSY]),
    # Groups that no rank has for itself, minibatches in which some have no row, a drawn entropy.
    "uneven": (3, ["num_envs=9", "rollout_steps=4", "groups=2", "actor=mlp_shared_mog",
                   "minibatches=9", "epochs=1", "loss.entropy_coeff=0.01", "caps=atalante",
                   "loss.normalize_advantage=batch", *BUSY]),
}  # fmt: skip


def updates(overrides: list[str], count: int) -> dict[str, Any]:
    """Figures of a few updates, and the weights after them; in all ranks that are there."""
    cfg = config(*overrides)
    with ranks_of(cfg) as ranks:
        return learned(cfg, ranks, count)


def learned(cfg: Any, ranks: Ranks, count: int) -> dict[str, Any]:
    torch.set_num_threads(1)  # with others, first weights are rounded otherwise
    learner = Learner(cfg, ranks)
    rows = []
    for _ in range(count):
        batch = learner.collect()
        figures = learner.learn(batch)
        figures |= batch_metrics(batch, learner.carrier, 0.04, ranks)
        figures["learning_rate"] = learner.optimizer.param_groups[0]["lr"]
        ranks.check_same(learner.parameters)
        rows.append(figures)
    weights = {key: value.clone() for key, value in learner.actor.state_dict().items()}
    return {"rows": rows, "weights": weights}


@pytest.mark.long
@pytest.mark.parametrize("kind", TRAININGS)
def test_ranks_learn_what_one_process_with_all_their_worlds_learns(kind, tmp_path):
    """Every figure of every update, and the weights; losses, masks, normalisers and all."""
    size, overrides = TRAININGS[kind]
    assert_same(updates(overrides, 4), in_each(updates, size, tmp_path, overrides, 4), 1e-4)


class InDouble(Transfers):
    """Networks and losses of float64 beside worlds of float32, as if on another device."""

    def __init__(self, device: str):
        super().__init__(device, copies=True)

    def place(self, modules: Iterable[Any]) -> None:
        for module in modules:
            for each in (module, *getattr(module, "_teacher", ())):
                if isinstance(each, nn.Module):
                    each.double()

    def there(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.apply(lambda x: x.double() if x.is_floating_point() else x)

    batch_there = there

    def back(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.apply(lambda x: x.float() if x.is_floating_point() else x)


def updates_in_double(overrides: list[str], count: int) -> dict[str, Any]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learner_module, "Transfers", InDouble)
        return updates(overrides, count)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["mlp", "gru"])
def test_two_ranks_of_256_worlds_learn_what_one_of_512_learns_in_ten_updates(kind, tmp_path):
    """Networks of float64; in float32 the physics makes roundings grow, in all worlds.

    What is left is that figures are float32.
    """
    size, overrides = TRAININGS[kind]
    usual = [each for each in overrides if each not in BUSY]
    full = [*usual, "num_envs=512", "groups=null"]
    alone = updates_in_double(full, 10)
    assert_same(alone, in_each(updates_in_double, size, tmp_path, full, 10), 1e-6)


def assert_same(alone: dict[str, Any], everyone: list[dict[str, Any]], tolerance: float) -> None:
    for rank, own in enumerate(everyone):
        for update, (one, other) in enumerate(zip(alone["rows"], own["rows"], strict=True)):
            assert one.keys() == other.keys()
            for key, value in one.items():
                told = f"{key} of update {update} on rank {rank}"
                close = pytest.approx(value, rel=tolerance, abs=tolerance, nan_ok=True)
                assert other[key] == close, told
        for key, value in own["weights"].items():
            assert torch.equal(value, everyone[0]["weights"][key])
            torch.testing.assert_close(value, alone["weights"][key], rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize(("rows", "drawn"), [([4, 1], 4), ([], 2)])
def test_rows_that_an_augmentation_adds_get_numbers_of_their_own(rows, drawn):
    """Of six rows twice; a rank without one has one taken along, and its image."""
    own = torch.tensor(rows, dtype=torch.long)
    share = PartOfMinibatch(SimpleNamespace(), own, own, 6).fitted(drawn)
    torch.manual_seed(5)
    whole = torch.randn(12, 3)
    torch.manual_seed(5)
    with share.drawing():
        mine = torch.randn(drawn, 3)
    places = [4, 1, 10, 7] if rows else [0, 0]
    assert torch.equal(mine, whole[places])


def test_each_of_three_ranks_has_a_third_of_the_worlds_cut_where_groups_end(tmp_path):
    """Ten worlds of one group and eight of another: 6 and 6 and 6."""
    assert in_each(pieces, 3, tmp_path) == [
        [Piece(0, 0, 6)],
        [Piece(0, 6, 4), Piece(1, 0, 2)],
        [Piece(1, 2, 6)],
    ]


def test_ranks_that_others_started_meet_at_an_address(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    found = in_each(pieces, 3, tmp_path, port=port)
    assert [own[-1] for own in found] == [Piece(0, 0, 6), Piece(1, 0, 2), Piece(1, 2, 6)]


def pieces() -> list[Piece]:
    with ranks_of(config()) as ranks:
        return ranks.pieces([10, 8], 1)


@pytest.mark.parametrize("sizes", [[5, 0, 3], [1, 1, 1], [0, 4, 0]])
def test_moments_of_parts_merge_to_those_of_all_rows(sizes):
    rows = torch.randn(sum(sizes), 3, dtype=torch.float64) * 5 + 100
    parts = (
        moments_of(part) if len(part) else (0, rows.new_zeros(3), rows.new_zeros(3))
        for part in rows.split(sizes)
    )
    for merged, whole in zip(merged_moments(parts), moments_of(rows), strict=True):
        torch.testing.assert_close(torch.as_tensor(merged), torch.as_tensor(whole))


@pytest.mark.parametrize(
    "draw",
    [
        torch.randn_like,
        torch.rand_like,
        lambda x: torch.randn(x.shape),
        lambda x: torch.rand(*x.shape),
        lambda x: x.new_empty(x.shape).uniform_(-1.0, 3.0),
        lambda x: torch.normal(x, x.abs() + 1.0),
        lambda x: torch.distributions.Normal(x, 2.0).sample(),
        lambda x: torch.stack([x, x]).normal_()[0],
        lambda x: torch.randn_like(x.T.contiguous().T),
    ],
)
def test_rows_get_the_numbers_that_they_get_among_all_rows(draw):
    """In any order, and with the generator where it would be then."""
    values = torch.arange(21.0).view(7, 3)
    torch.manual_seed(3)
    whole, after = draw(values), torch.rand(1)
    places = torch.tensor([5, 0, 3])

    def supply(kind: Draw) -> Tensor:
        return kind.of(7).index_select(kind.axis, places)

    torch.manual_seed(3)
    with DrawnTogether(3, supply):
        mine = draw(values[places])
    assert torch.equal(mine, whole[places])
    assert torch.equal(torch.rand(1), after)


def test_numbers_that_could_not_be_shared_are_refused():
    with (
        pytest.raises(ValueError, match=r"launch\.ranks .* bernoulli"),
        DrawnTogether(3, lambda draw: draw.of(3)),
    ):
        torch.bernoulli(torch.full((3,), 0.5))


@pytest.mark.parametrize(
    "draw",
    [
        lambda rows: torch.normal(rows, 0.1),
        lambda rows: rows.normal_(std=0.1),
        lambda rows: torch.randn(3, 2, requires_grad=False),
        lambda rows: torch.nn.functional.alpha_dropout(rows, 0.5, training=True),
        lambda rows: torch.distributions.Gamma(rows + 2.0, rows + 2.0).sample(),
        lambda rows: rows.repeat(5, 1).normal_(),
    ],
    ids=["number", "keyword", "flag", "dropout", "gamma", "flattened"],
)
def test_draws_that_are_not_known_are_refused_by_the_generator_that_has_moved(draw):
    with (
        pytest.raises(ValueError, match=r"launch\.ranks must be 1 .* draws are not for the rows"),
        DrawnTogether(3, lambda asked: asked.of(3)),
    ):
        draw(torch.zeros(3, 2))


def test_ranks_that_have_come_apart_are_found(tmp_path):
    errors = in_each(apart, 2, tmp_path)
    for error in errors:
        assert "random numbers of rank 1" in str(error)


def apart() -> None:
    with ranks_of(config()) as ranks:
        torch.manual_seed(ranks.rank)
        ranks.check_same([torch.ones(2)])


def test_ranks_add_sums_and_weigh_means_and_leave_out_what_nobody_has(tmp_path):
    """(1 of 3 and 5 of 1: 2); 4 + 2 episodes. Of none there is no mean."""
    for found in in_each(means, 2, tmp_path):
        assert found == {"reward": 2.0, "episodes": 6}


def means() -> dict[str, float]:
    with ranks_of(config()) as ranks:
        value, weight, ended = ((1.0, 3.0, 4), (5.0, 1.0, 2))[ranks.rank]
        none = (float("nan"), 0)
        return ranks.means({"reward": (value, weight), "episodes": (ended, None), "none": none})
