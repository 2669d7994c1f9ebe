"""The reference of the targets goes from standing to a safe posture once it is to kneel."""

import dataclasses
import math

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.robots import ZEROTH01
from zfall.envs.transforms.actions import KneelReference

KNEEL = torch.tensor(ZEROTH01.kneel_position)
KNEE = ZEROTH01.joints.index("right_knee_pitch")


def step(
    reference: KneelReference,
    mode: list[int],
    target: torch.Tensor,
    *,
    velocity: tuple[float, float] = (0.0, 0.0),
    facing: float = 0.0,
) -> torch.Tensor:
    """Targets after a step in which all robots move and face alike [m/s, rad]."""
    n = len(mode)
    turn = torch.tensor([math.cos(facing / 2), 0.0, 0.0, math.sin(facing / 2)])
    td = TensorDict(
        {
            "mode": torch.nn.functional.one_hot(torch.tensor(mode), 3).float(),
            "target": target,
            "base_orientation": turn.expand(n, -1),
            "com_velocity": torch.tensor([*velocity, 0.0]).expand(n, -1),
        },
        batch_size=[n],
    )
    return reference._inv_call(td)["target"]


def test_targets_stand_in_recover_and_go_to_the_kneel_at_the_speed(make_base):
    """World 1 begins to kneel: after k steps a joint has gone k * 4 rad/s * 0.04 s, to its end."""
    env = make_base(num_envs=2, control_dt=0.04)
    reference = KneelReference(env, speed=4.0)
    stand = env.stand_position.expand(2, -1)
    away = KNEEL - stand[0]
    for k in range(1, 13):
        out = step(reference, [0, 1], stand)
        assert torch.equal(out[0], stand[0])
        gone = away.sign() * away.abs().clamp_max(0.16 * k)
        assert_close(out[1], stand[1] + gone)
    assert_close(out[1], KNEEL)
    assert_close(step(reference, [1, 2], stand)[1], KNEEL)  # STABLE stays there
    assert_close(step(reference, [0, 0], stand), stand)  # back


def catch(heading: int) -> torch.Tensor:
    """The stored pose for a heading [degrees], or the mirror image of the one on the left."""
    pose = torch.zeros(20)
    for joint, angle in ZEROTH01.catches[abs(heading)].items():
        if heading >= 0:
            pose[ZEROTH01.joints.index(joint)] = angle
        else:
            keeps = any(word in joint for word in ZEROTH01.mirror_keeps_sign)
            pose[ZEROTH01.joints.index(ZEROTH01.mirror[joint])] = angle if keeps else -angle
    return pose


@pytest.mark.parametrize(
    ("degrees", "nearest"),
    [(0, 0), (20, 0), (-20, 0), (25, 45), (80, 90), (-80, -90), (-50, -45), (-130, -135), (160, 180), (-160, 180)],
)  # fmt: skip
@pytest.mark.parametrize("facing", [0.0, 2.0])
def test_the_posture_follows_the_way_it_falls_and_stays(make_base, degrees, nearest, facing):
    """Headings of the velocity from the robot's own; reversed later, it makes no difference."""
    env = make_base(num_envs=1)
    reference = KneelReference(env, speed=1000.0)
    stand = env.stand_position[None]
    assert_close(step(reference, [1], stand)[0], KNEEL)  # does not move yet
    heading = math.radians(degrees) + facing
    falling = (0.5 * math.cos(heading), 0.5 * math.sin(heading))
    out = step(reference, [1], stand, velocity=falling, facing=facing)[0]
    assert_close(out, torch.clamp(catch(nearest), *env.joint_range.unbind(-1)))
    later = step(reference, [1], stand, velocity=(-falling[0], -falling[1]), facing=facing)[0]
    assert_close(later, out)


@pytest.mark.parametrize("heading", [0, 45, 90, 135, 180, -135, -90, -45])
def test_the_stored_postures_catch_a_fall_of_their_heading(make_base, heading):
    """Pushed by I = 0.7 at the torso, without a policy: torso and head stay off the floor."""
    env = make_base(num_envs=1, control_dt=0.04)
    reference = KneelReference(env)
    td = env.reset()
    angle = math.radians(heading)
    force = 0.7 * env.robot.impulse_unit / 0.1
    region = [env.regions.index(name) for name in ("torso", "head")]
    for k in range(60):
        td["mode"] = torch.eye(3)[[0 if k < 3 else 1]]
        td["target"] = env.stand_position[None].clone()
        td = reference._inv_call(td)
        wrench = torch.zeros(1, 10, env.num_bodies, 6)
        if k < 3:  # 0.1 s
            on = 10 if k < 2 else 5
            wrench[:, :on, env.push_targets["torso"], 0] = force * math.cos(angle)
            wrench[:, :on, env.push_targets["torso"], 1] = force * math.sin(angle)
        td["push", "wrench"] = wrench
        td = env.step(td)["next"]
        assert (td["contact_force_peak"][0, region] == 0).all(), k
    assert td["com_position"][0, 2] < 0.7 * env.robot.com_height
    assert td["base_linear_velocity"].norm() < 0.1


def test_a_policy_corrects_the_script_within_the_joint_ranges(make_base):
    env = make_base(num_envs=2, control_dt=0.04)
    reference = KneelReference(env, speed=1000.0)
    correction = torch.zeros(2, 20)
    correction[0, KNEE], correction[1, KNEE] = 0.3, -9.0
    out = step(reference, [1, 1], env.stand_position + correction)
    assert_close(out[0, KNEE], KNEEL[KNEE] + 0.3)
    assert_close(out[1, KNEE], env.joint_range[KNEE, 0])


def test_a_reset_begins_from_standing_in_its_rows_alone(make_base):
    env = make_base(num_envs=2)
    reference = KneelReference(env)
    stand = env.stand_position.expand(2, -1)
    step(reference, [1, 1], stand, velocity=(-0.5, 0.0))
    before = reference.way.clone()
    assert reference.choice.tolist() == [4, 4]  # straight back
    rows = TensorDict({"_reset": torch.tensor([[False], [True]])}, batch_size=[2])
    reference._reset(rows, TensorDict(batch_size=[2]))
    assert torch.equal(reference.way[0], before[0])
    assert torch.equal(reference.way[1], stand[1])
    assert reference.choice.tolist() == [4, 8]


def test_commands_made_before_it_are_refused(make_base):
    env = make_base(num_envs=1)
    td = TensorDict({"mode": torch.eye(3)[:1], "control": torch.zeros(1, 10, 20)}, batch_size=[1])
    with pytest.raises(ValueError, match="must come right after a JointPositionTarget"):
        KneelReference(env)._inv_call(td)


def test_bad_values_are_refused(make_base):
    with pytest.raises(ValueError, match="speed must be positive, got 0"):
        KneelReference(make_base(), speed=0.0)
    robot = dataclasses.replace(ZEROTH01, catches={})
    env = HumanoidEnv(num_envs=1, robot=robot, control_dt=0.04, physics_dt=0.004)
    with pytest.raises(
        ValueError, match="needs a robot with a kneel and catches for .* zeroth01 has"
    ):
        KneelReference(env)
