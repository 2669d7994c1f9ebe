"""Recorded falls that go on with a movement, and how they end."""

import math

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.transforms.actions import ActuatorDelay
from zfall.falling.bank_worlds import BankWorlds
from zfall.falling.files import own_file
from zfall.falling.movements import load_catches
from zfall.falling.recorded_falls import Falls, Landing, caught
from zfall.robots import ZEROTH01

BANK = own_file(ZEROTH01, "falls.npz")


def standing(env, headings, speeds, facing):
    """States of robots that stand, face a way [rad] and move [degrees from it, m/s]."""
    td = env.reset()
    states = {key: td[key].clone() for key in STATE_KEYS}
    way = torch.deg2rad(torch.tensor(headings)) + facing
    speed = torch.tensor(speeds)
    states["base_orientation"][:] = torch.tensor([math.cos(facing / 2), 0, 0, math.sin(facing / 2)])
    states["base_linear_velocity"] = torch.stack(
        [speed * way.cos(), speed * way.sin(), torch.zeros_like(speed)], -1
    )
    states |= {"push_force": torch.zeros(len(speed), 3), "push_left": torch.zeros(len(speed), 1)}
    return {key: value.numpy() for key, value in states.items()}


@pytest.mark.parametrize("facing", [0.0, 2.0])
def test_falls_are_told_apart_by_heading_and_speed(tmp_path, facing):
    """Robots that stand and move as a whole: the center of mass is as fast as the base."""
    worlds = BankWorlds(4)
    states = standing(worlds.base, [0.0, 100.0, -170.0, 175.0], [1.0, 1.0, 1.0, 2.0], facing)
    np.savez(tmp_path / "falls.npz", **states)
    falls = Falls(worlds, tmp_path / "falls.npz")
    assert falls.heading.tolist() == pytest.approx([0.0, 100.0, -170.0, 175.0], abs=0.5)
    assert falls.speed.tolist() == pytest.approx([1.0, 1.0, 1.0, 2.0], rel=1e-3)
    assert falls.like(90, 0.0, 1.5).tolist() == [1]
    assert falls.like(180, 0.0, 1.5).tolist() == [2]
    assert falls.like(180, 0.0, 3.0).tolist() == [2, 3]
    assert falls.like(-90, 0.0, 3.0).tolist() == []


def test_falls_to_the_left_are_caught_by_images_of_movements_for_the_right(tmp_path, monkeypatch):
    """100 degrees to the left is -100 in the mirror, and what the robot then does is the image."""
    worlds = BankWorlds(2)
    np.savez(tmp_path / "falls.npz", **standing(worlds.base, [100.0, -100.0], [1.0, 1.0], 2.0))
    falls = Falls(worlds, tmp_path / "falls.npz", mirrored=True)
    assert falls.heading.tolist() == pytest.approx([-100.0, -100.0], abs=0.5)
    assert falls.mirrored.tolist() == [True, False]
    assert falls.like(-90, 0.0, 3.0).tolist() == [0, 1]
    targets, step = [], worlds.env.step
    monkeypatch.setattr(worlds.env, "step", lambda td: targets.append(td["target"]) or step(td))
    moves = worlds.base.stand_position.repeat(2, 1, 1).clone()
    moves[:, 0, ZEROTH01.joints.index("right_hip_pitch")] -= 0.1
    moves[:, 0, ZEROTH01.joints.index("right_ankle_roll")] += 0.05
    caught(falls, torch.tensor([0, 1]), moves, torch.tensor([torch.inf]))
    left, right = (targets[0] - worlds.base.stand_position).unbind()
    moved = {ZEROTH01.joints[i]: round(right[i].item(), 4) for i in right.nonzero()[:, 0]}
    assert moved == {"right_hip_pitch": -0.1, "right_ankle_roll": 0.05}
    moved = {ZEROTH01.joints[i]: round(left[i].item(), 4) for i in left.nonzero()[:, 0]}
    assert moved == {"left_hip_pitch": -0.1, "left_ankle_roll": -0.05}


def test_what_is_left_of_a_push_goes_on(tmp_path):
    """10 N for 0.06 s: all of the first step of 0.04 s, half of the second; 0.6 N s in all.

    The speed is that after the first of them, when the movement is chosen for good.
    """
    worlds = BankWorlds(2)
    states = standing(worlds.base, [0.0, 0.0], [1.0, 1.0], 0.0)
    states["push_force"][1], states["push_left"][1] = [10.0, 0.0, 0.0], 0.06
    np.savez(tmp_path / "falls.npz", **states)
    falls, rows = Falls(worlds, tmp_path / "falls.npz"), torch.tensor([0, 1])
    assert (falls.speed[1] - falls.speed[0]).item() == pytest.approx(
        0.4 / worlds.base.mass, rel=1e-3
    )
    impulse = torch.zeros(2, 3)
    for time in (0.0, 0.04):
        impulse += falls.wrench(rows, time)[..., :3].sum((1, 2)) * worlds.base.physics_dt
    assert_close(impulse, torch.tensor([[0.0, 0, 0], [0.6, 0, 0]]))
    assert falls.wrench(rows, 0.08) is None


@pytest.mark.parametrize("world", [None, "twin"])
def test_a_fall_goes_on_as_it_was_recorded(tmp_path, world):
    """In the twin too, where the env has transforms and the last target is still on its way."""
    worlds = BankWorlds(2, world)
    states = standing(worlds.base, [0.0, 90.0], [1.0, 2.0], 0.0)
    states["joint_position"] += np.array([[0.05], [0.1]], np.float32)
    states["target"] = states["joint_position"] + np.float32(0.2)
    np.savez(tmp_path / "falls.npz", **states)
    falls = Falls(worlds, tmp_path / "falls.npz")
    td = falls.begin(torch.tensor([1, 0]))
    for key in STATE_KEYS:
        assert_close(td[key], torch.from_numpy(states[key])[[1, 0]], atol=1e-5, rtol=0)
    late = [t for t in worlds.env.transform if isinstance(t, ActuatorDelay)]
    assert len(late) == (0 if world is None else 2)
    for transform in late:
        assert_close(transform.history[:, 0], torch.from_numpy(states["target"])[[1, 0]])
    assert falls.speed.tolist() == pytest.approx([1.0, 2.0], rel=1e-2)


def test_a_file_that_the_worlds_do_not_fill_evenly_is_read_whole(tmp_path):
    worlds = BankWorlds(5)
    states = standing(worlds.base, [0.0, 30.0, 60.0, 90.0, 120.0], [1.0] * 5, 0.0)
    np.savez(tmp_path / "falls.npz", **states)
    falls = Falls(BankWorlds(3), tmp_path / "falls.npz")
    assert falls.heading.tolist() == pytest.approx([0.0, 30.0, 60.0, 90.0, 120.0], abs=0.5)


@pytest.mark.parametrize("heading", [0, 90, 180, 270])
def test_stored_movements_catch_falls_that_standing_does_not(heading):
    worlds = BankWorlds(32)
    env = worlds.base
    falls, known = Falls(worlds, BANK), load_catches(ZEROTH01)
    rows = falls.like(heading, 0.0, float(known.speeds[0]))
    rows = rows[torch.arange(16) % len(rows)].repeat(2)
    stand = env.stand_position.expand(16, known.postures.shape[2], -1)
    moves = torch.cat([known.postures[heading // 30, 0].expand(16, -1, -1), stand])
    safe, kneels, lasted, upright, force, acceleration = caught(falls, rows, moves, known.until)
    assert kneels[:16].float().mean() >= 0.5
    assert not kneels[16:].any()
    assert not safe[16:].any()
    assert (lasted[safe] > 0.999).all()
    assert (lasted[16:] < 0.999).all()
    assert (upright[16:] == 0).all()
    assert (upright[kneels] > math.cos(0.6)).all()  # as upright as a kneel must be
    assert (force[16:] > 3.35 * 9.81).all()  # more than its weight: it falls on torso or head
    assert acceleration[:16].mean() < acceleration[16:].mean()


def test_what_strikes_soon_after_the_first_touch_counts_and_what_comes_later_does_not(monkeypatch):
    """Torso at 0.08 s with 10 N; then the head: at 0.56 s with 30 N, or at 0.6 s, too late."""
    worlds = BankWorlds(3)
    env = worlds.base
    falls, time = Falls(worlds, BANK), 0.0
    torso, head = (env.regions.index(region) for region in ("torso", "head"))
    step = worlds.env.step

    def scripted(td):
        nonlocal time
        time, out = time + env.control_dt, step(td)
        force = torch.zeros_like(out["next", "contact_force_peak"])
        for row, late in enumerate((0.56, 0.6)):
            force[row, torso] = 10.0 * (abs(time - 0.08) < 0.01)
            force[row, head] = 30.0 * (abs(time - late) < 0.01)
        out["next", "contact_force_peak"] = force
        out["next", "diverged"][2] = abs(time - 0.2) < 0.01
        return out

    monkeypatch.setattr(worlds.env, "step", scripted)
    rows, known = torch.tensor([0, 0, 0]), load_catches(ZEROTH01)
    landing = caught(falls, rows, env.stand_position.expand(3, 5, -1), known.until)
    assert landing.force[:2].tolist() == [30.0, 10.0]
    assert landing.lasted[:2].tolist() == pytest.approx([1 / 38, 1 / 38])
    # Where the physics failed nothing is known: the worst, though that world stands again.
    assert landing.score[2].item() == pytest.approx(4 / 38)


def test_a_score_tells_apart_what_is_worse_in_one_thing():
    """By hand: 2 for a kneel, 1 each for rest, time and tilt, 2 each for no force and no impact."""
    yes, no = torch.tensor([True]), torch.tensor([False])
    best = Landing(yes, yes, *torch.tensor([[1.0], [1.0], [0.0], [0.0]]))
    assert best.score.item() == 9.0
    assert best._replace(kneels=no).score.item() == 7.0
    assert best._replace(safe=no).score.item() == 8.0
    assert best._replace(upright=torch.tensor([0.5])).score.item() == 8.5
    assert best._replace(force=torch.tensor([300.0])).score.item() == 8.5
    assert best._replace(acceleration=torch.tensor([100.0])).score.item() == 8.5
    assert best._replace(acceleration=torch.tensor([1e6])).score.item() == 7.0
