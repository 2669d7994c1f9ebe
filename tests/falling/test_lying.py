"""How robots lie before they get up."""

import math

import numpy as np
import pytest
import torch

from zfall.envs.humanoid import STATE_KEYS
from zfall.falling.banks import save_bank
from zfall.falling.lying import POSTURES, load_lying, lying_bank, posture_of, settled
from zfall.robots import ZEROTH01


def test_the_posture_is_where_gravity_points():
    """Facing down it points to the front, on the left side to the left, upright down."""
    down = {"belly": (1, 0, 0), "back": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0)}
    for posture, gravity in (down | {"kneel": (0, 0, -1)}).items():
        off = torch.tensor(gravity).float() + torch.tensor([0.3, 0.2, -0.3])
        assert POSTURES[posture_of(off[None]).item()] == posture


@pytest.mark.parametrize("posture", ["back", "belly", "left"])
def test_robots_that_were_let_go_lie_still_in_the_posture(make_base, posture):
    env = make_base(num_envs=16)
    states = settled(env, posture, np.random.default_rng(0), held=True)
    count = len(states["target"])
    assert count >= 1
    assert {key: value.shape[0] for key, value in states.items()} == dict.fromkeys(states, count)
    assert (states["base_position"][:, 2] < 0.12).all()  # no robot of 0.4 m that lies is as high
    assert (states["base_angular_velocity"].abs() < 0.2).all()
    assert (states["joint_position"] - states["target"]).abs().max() > 0.01  # the servos give way
    limp = settled(
        make_base(num_envs=16, powered=False), posture, np.random.default_rng(0), held=False
    )
    if len(limp["target"]):
        assert torch.equal(limp["target"], limp["joint_position"])


def test_a_bank_has_as_many_of_each_posture_and_is_read_as_it_was_written(make_base, tmp_path):
    bank = lying_bank(make_base(num_envs=24), make_base(num_envs=24, powered=False), 2, seed=0)
    assert bank["posture"].tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    save_bank(tmp_path / "lying.npz", bank)
    again = load_lying(ZEROTH01, tmp_path / "lying.npz")
    assert set(again) == {*STATE_KEYS, "target", "posture"}
    assert all(torch.equal(again[key], bank[key]) for key in again)


def test_a_bank_that_says_no_posture_is_refused(tmp_path):
    bank = load_lying(ZEROTH01)
    save_bank(tmp_path / "bank.npz", bank | {"posture": bank["posture"] + 3})
    with pytest.raises(ValueError, match="does not say a posture of each state"):
        load_lying(ZEROTH01, tmp_path / "bank.npz")


def test_what_ships_lies_in_each_posture_as_often():
    """64 of each; what gravity says in the state is what the bank says."""
    bank = load_lying(ZEROTH01)
    assert torch.bincount(bank["posture"], minlength=5).tolist() == [64] * 5
    w, x, y, z = bank["base_orientation"].unbind(-1)
    gravity = -torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1)
    assert torch.equal(posture_of(gravity), bank["posture"])
    assert (bank["base_orientation"].norm(dim=-1) - 1).abs().max() < 1e-4
    assert math.isclose(bank["base_position"][:, :2].abs().max().item(), 0.0)
