"""In mode RISE the targets go along the movement for the posture in which the robot lies."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.falling.lying import POSTURES
from zfall.falling.modes import RECOVER, RISE, STABLE
from zfall.falling.rise_reference import RiseReference
from zfall.falling.rises import save_rises, written_rises
from zfall.robots import ZEROTH01

HIP = ZEROTH01.joints.index("left_hip_pitch")
DOWN = {"belly": (1.0, 0.0, 0.0), "back": (-1.0, 0.0, 0.0), "kneel": (0.0, 0.0, -1.0)}
# How far the left hip is bent at the end of each movement, which takes 0.2 s: 5 steps.
ANGLES = dict(zip(POSTURES, (-0.5, -1.0, 0.1, 0.2, -1.5), strict=True))


@pytest.fixture
def rises(tmp_path) -> str:
    table = {
        name: {
            "posture": name,
            "goal": "stand" if name in ("belly", "kneel") else "belly",
            "keyframes": [{"seconds": 0.2, "left_hip_pitch": angle}],
        }
        for name, angle in ANGLES.items()
    }
    save_rises(tmp_path / "rises.npz", written_rises(ZEROTH01, table))
    return str(tmp_path / "rises.npz")


def step(reference: RiseReference, mode: int, posture: str, target: torch.Tensor) -> float:
    """The target of the left hip after a step [rad]."""
    td = TensorDict(
        {
            "mode": torch.nn.functional.one_hot(torch.tensor([mode]), 4).float(),
            "base_acceleration": -9.81 * torch.tensor([DOWN[posture]]),
            "joint_position": target.clone(),
            "target": target.clone(),
        },
        batch_size=[1],
    )
    return reference._inv_call(td)["target"][0, HIP].item()


def begin(reference: RiseReference, env, posture: str) -> torch.Tensor:
    td = TensorDict(
        {
            "joint_position": env.stand_position[None],
            "base_acceleration": -9.81 * torch.tensor([DOWN[posture]]),
        },
        batch_size=[1],
    )
    reference._reset(TensorDict(batch_size=[1]), td)
    return env.stand_position[None].clone()


def test_the_movement_begins_where_the_target_stopped_and_goes_on_from_there(make_base, rises):
    """The hip stopped at -0.2: in five steps it goes to -1 in equal parts, and stays."""
    env = make_base(num_envs=1)
    reference = RiseReference(env, rises=rises)
    target = begin(reference, env, "belly")
    target[0, HIP] = -0.2
    assert step(reference, RECOVER, "belly", target) == pytest.approx(-0.2)
    target[0, HIP] = 0.7  # of a policy that acts on: StableHold keeps the last target
    assert step(reference, STABLE, "belly", target) == pytest.approx(0.7)
    goes = [step(reference, RISE, "belly", target) for _ in range(7)]
    assert goes == pytest.approx([-0.36, -0.52, -0.68, -0.84, -1.0, -1.0, -1.0])


def test_what_ends_on_the_belly_goes_on_at_once(make_base, rises):
    """From the back it rolls to the belly: after 0.2 s, without a pause, the next begins."""
    env = make_base(num_envs=1)
    reference = RiseReference(env, rises=rises, pause=0.4)
    target = begin(reference, env, "back")
    goes = [step(reference, RISE, "back" if k < 2 else "belly", target) for k in range(20)]
    assert goes[4:10] == pytest.approx([-0.5, -0.6, -0.7, -0.8, -0.9, -1.0])


def test_what_does_not_arrive_on_the_belly_may_roll_on_before_it_begins_anew(make_base, rises):
    """On its back after 0.2 s: after a pause of 0.08 s the movement for that begins again."""
    env = make_base(num_envs=1)
    reference = RiseReference(env, rises=rises, pause=0.08)
    target = begin(reference, env, "back")
    clocks = []
    for _ in range(9):
        step(reference, RISE, "back", target)
        clocks.append(reference.clock.item())
    assert clocks == [1, 2, 3, 4, 5, 6, 7, 1, 2]


def test_what_ends_upright_waits_before_it_begins_anew_as_from_a_kneel(make_base, rises):
    env = make_base(num_envs=1)
    reference = RiseReference(env, rises=rises, pause=0.08, patience=0.4)
    target = begin(reference, env, "belly")
    goes = [step(reference, RISE, "belly" if k < 2 else "kneel", target) for k in range(20)]
    assert goes[4:15] == pytest.approx([-1.0] * 11)
    assert goes[15:20] == pytest.approx([-1.1, -1.2, -1.3, -1.4, -1.5])


def test_what_falls_on_its_back_while_it_gets_up_rolls_over_at_once(make_base, rises):
    env = make_base(num_envs=1)
    reference = RiseReference(env, rises=rises)
    target = begin(reference, env, "belly")
    step(reference, RISE, "belly", target)
    for _ in range(8):  # the accelerometer is averaged
        step(reference, RISE, "back", target)
    assert reference.rises.names[reference.number.item()] == "back"


def test_a_rise_that_was_left_begins_anew(make_base, rises):
    env = make_base(num_envs=1)
    reference = RiseReference(env, rises=rises)
    target = begin(reference, env, "belly")
    first = [step(reference, RISE, "belly", target) for _ in range(3)]
    assert step(reference, RECOVER, "belly", target) == pytest.approx(target[0, HIP].item())
    assert [step(reference, RISE, "belly", target) for _ in range(3)] == pytest.approx(first)


def test_other_joints_and_worlds_keep_their_targets(make_base, rises):
    env = make_base(num_envs=2)
    reference = RiseReference(env, rises=rises)
    target = torch.rand(2, 20)
    td = TensorDict(
        {
            "mode": torch.nn.functional.one_hot(torch.tensor([RECOVER, RISE]), 4).float(),
            "base_acceleration": torch.tensor([[-9.81, 0.0, 0.0]] * 2),
            "joint_position": target.clone(),
            "target": target.clone(),
        },
        batch_size=[2],
    )
    out = reference._inv_call(td)["target"]
    assert_close(out[0], target[0])
    assert not torch.equal(out[1], target[1])


def test_a_machine_without_rise_and_negative_times_are_refused(make_base, rises):
    env = make_base(num_envs=1)
    td = TensorDict({"mode": torch.zeros(1, 3), "target": torch.zeros(1, 20)}, batch_size=[1])
    with pytest.raises(ValueError, match="needs a ModeMachine with rise"):
        RiseReference(env, rises=rises)._inv_call(td)
    for name in ("pause", "patience"):
        with pytest.raises(ValueError, match=f"{name} must not be negative, got -1"):
            RiseReference(env, rises=rises, **{name: -1.0})
