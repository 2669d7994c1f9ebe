"""The reference of the targets goes from standing to a safe posture once it is to kneel."""

import dataclasses
import math

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.humanoid import HumanoidEnv
from zfall.falling.kneel_reference import KneelReference
from zfall.falling.movements import load_catches, save_catches
from zfall.falling.recorded_falls import last_choice
from zfall.robots import ZEROTH01

KNEEL = torch.tensor(ZEROTH01.posture("kneel"))
KNEE, LEFT = (ZEROTH01.joints.index(f"{side}_knee_pitch") for side in ("right", "left"))


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


def test_each_world_may_have_its_own_speed(make_base):
    env = make_base(num_envs=20, control_dt=0.04)  # as many worlds as joints
    reference = KneelReference(env)
    reference.speed = torch.linspace(0.1, 2.0, 20)
    stand = env.stand_position.expand(20, -1)
    gone = (step(reference, [1] * 20, stand) - stand).abs().amax(1)
    assert_close(gone, 0.04 * reference.speed)


@pytest.mark.parametrize("control_dt", [0.04, 0.02, 0.012])
def test_the_search_knows_falls_by_the_push_that_acts_until_the_last_choice(
    make_base, stored, control_dt
):
    """The heading turns by a sector in each step: a choice changes as long as it is open."""
    reference = KneelReference(make_base(num_envs=1, control_dt=control_dt), catches=stored)
    stand, last = torch.zeros(1, 20), 0
    for number in range(12):
        before, angle = reference.choice.clone(), math.radians(30.0 * number)
        step(reference, [1], stand, velocity=(math.cos(angle), math.sin(angle)))
        last = number if reference.choice != before else last
    assert last_choice(control_dt) == pytest.approx(last * control_dt)


@pytest.fixture
def stored(tmp_path):
    """Movements of three postures, of which the left knee says [rad]: -sector/10 - posture/100."""
    postures = torch.zeros(12, 1, 3, 20)
    postures[..., LEFT] = -torch.arange(12.0)[:, None, None] / 10 - torch.arange(3.0) / 100
    path = tmp_path / "catches.npz"
    save_catches(path, postures, torch.tensor([0.08, 0.2, torch.inf]), torch.zeros(0))
    return str(path)


def velocity(degrees: float, facing: float = 0.0, speed: float = 0.5) -> tuple[float, float]:
    way = math.radians(degrees) + facing
    return speed * math.cos(way), speed * math.sin(way)


@pytest.mark.parametrize(
    ("degrees", "sector"), [(0, 0), (14, 0), (35, 1), (95, 3), (180, 6), (-30, 11)]
)
@pytest.mark.parametrize("facing", [0.0, 2.0])
def test_the_movement_follows_the_way_it_falls_and_stays(
    make_base, stored, degrees, sector, facing
):
    """Headings of the velocity from the robot's own; reversed after 0.08 s it makes no difference."""
    env = make_base(num_envs=1, control_dt=0.04)
    reference = KneelReference(env, speed=1000.0, catches=stored)
    stand = env.stand_position[None]
    assert_close(step(reference, [1], stand)[0], KNEEL)  # does not move yet
    there, back = velocity(degrees, facing), velocity(degrees + 180, facing)
    knees = [
        step(reference, [1], stand, velocity=v, facing=facing)[0, LEFT].item()
        for v in (there, there, back, back, back, back)
    ]
    postures = [0, 0, 1, 1, 1, 2]  # at 0, 0.04, 0.08 ... 0.2 s
    assert knees == pytest.approx([-sector / 10 - k / 100 for k in postures])


def test_the_first_steps_may_choose_anew_while_a_push_goes_on(make_base, stored):
    env = make_base(num_envs=1, control_dt=0.04)
    reference = KneelReference(env, speed=1000.0, catches=stored)
    stand = env.stand_position[None]
    ways = (0, 60, 120)  # at 0, 0.04 and 0.08 s: the last one comes too late
    knees = [step(reference, [1], stand, velocity=velocity(way))[0, LEFT].item() for way in ways]
    assert knees == pytest.approx([0.0, -0.2, -0.21])


@pytest.mark.parametrize("heading", [0, 60, 120, -120, -60])
def test_the_stored_movements_catch_a_fall_of_their_heading(make_base, heading):
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
    assert td["com_position"][0, 2] < 0.75 * env.robot.com_height
    assert td["base_linear_velocity"].norm() < 0.1


def test_corrections_count_while_it_lands_and_fade_away(make_base, stored):
    """A correction of 0.1 rad: whole to 0.16 s, gone at 0.32 s, by a line; begins anew."""
    env = make_base(num_envs=1, control_dt=0.04)
    reference = KneelReference(env, speed=1000.0, catches=stored, landing=0.16)
    stand = env.stand_position[None]
    asked = stand.clone()
    asked[0, LEFT] -= 0.1
    shares = [1.0, 1.0, 1.0, 1.0, 1.0, 0.75, 0.5, 0.25, 0.0, 0.0]
    for again in range(2):
        ahead = velocity(90)
        knees = [step(reference, [1], asked, velocity=ahead)[0, LEFT].item() for _ in shares]
        script = [-0.3 - k / 100 for k in (0, 0, 1, 1, 1, 2, 2, 2, 2, 2)]
        expected = [way - 0.1 * share for way, share in zip(script, shares, strict=True)]
        assert knees == pytest.approx(expected, abs=1e-5), again
        assert_close(step(reference, [0], asked), asked)  # all of it while it recovers


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
    back = 6 * (len(load_catches(ZEROTH01).speeds) + 1)  # 180 degrees, the slowest of its speeds
    assert reference.choice.tolist() == [back, back]
    assert reference.clock.tolist() == [1, 1]
    rows = TensorDict({"_reset": torch.tensor([[False], [True]])}, batch_size=[2])
    reference._reset(rows, TensorDict(batch_size=[2]))
    assert torch.equal(reference.way[0], before[0])
    assert torch.equal(reference.way[1], stand[1])
    assert reference.choice.tolist() == [back, reference.none]
    assert reference.clock.tolist() == [1, 0]


def test_commands_made_before_it_are_refused(make_base):
    env = make_base(num_envs=1)
    td = TensorDict({"mode": torch.eye(3)[:1], "control": torch.zeros(1, 10, 20)}, batch_size=[1])
    with pytest.raises(ValueError, match="must come right after a JointPositionTarget"):
        KneelReference(env)._inv_call(td)


def test_bad_values_are_refused(make_base):
    with pytest.raises(ValueError, match="speed must be positive, got 0"):
        KneelReference(make_base(), speed=0.0)
    with pytest.raises(
        ValueError, match="catches must be a file that recipes.falling.catches wrote"
    ):
        KneelReference(make_base(), catches="nowhere.npz")
    robot = dataclasses.replace(ZEROTH01, postures={})
    env = HumanoidEnv(num_envs=1, robot=robot, control_dt=0.04, physics_dt=0.004)
    with pytest.raises(ValueError, match="zeroth01 must have a posture 'kneel'"):
        KneelReference(env)
