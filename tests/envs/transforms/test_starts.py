"""How episodes begin."""

import mujoco
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import Compose, TransformedEnv
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.terms.falls import body_contact
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import NoisyStart, ReferenceStart, ScriptedStart
from zfall.motions.library import load_motions
from zfall.robots import ZEROTH01
from zfall.rotations import rotate_inverse, tilt

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}


def test_noise_has_its_deviations_around_the_standing_pose(make_task):
    values = {"joint_position": 0.05, "joint_velocity": 0.3}
    env = make_task({**ACTION, "start": (NoisyStart, values)}, num_envs=512)
    check_env_specs(env)
    td = env.reset()
    error = td["joint_position"] - env.base_env.stand_position
    assert error.std().item() == pytest.approx(0.05, rel=0.05)  # 10240 draws: 7 sigma
    assert td["joint_velocity"].std().item() == pytest.approx(0.3, rel=0.05)
    low, high = env.base_env.joint_range.unbind(-1)
    assert ((td["joint_position"] >= low) & (td["joint_position"] <= high)).all()


def test_partial_reset_draws_the_same_stream_whoever_fell(make_task):
    """Two envs of one seed; in one of them worlds 0 and 1 reset before world 2 does."""
    starts = []
    for fallen in ([2], [0, 1, 2]):
        env = make_task({**ACTION, "start": (NoisyStart, {"joint_position": 0.05})}, num_envs=3)
        env.set_seed(4)
        td = env.reset()
        rows = torch.zeros(3, 1, dtype=torch.bool)
        rows[fallen] = True
        td["_reset"] = rows
        starts.append(env.reset(td)["joint_position"][2])
    assert torch.equal(starts[0], starts[1])


def reference(make_task, num_envs: int = 256, **values: object):
    return make_task({**ACTION, "start": (ReferenceStart, values)}, num_envs=num_envs)


def heading(quaternion: torch.Tensor) -> torch.Tensor:
    """Of an upright body [rad]."""
    return 2 * torch.atan2(quaternion[:, 3], quaternion[:, 0])


@pytest.mark.parametrize("turned", [False, True])
def test_reference_starts_are_states_of_the_motions_with_a_foot_at_rest_on_the_floor(
    make_task, turned
):
    env = reference(make_task, heading=turned)
    check_env_specs(env)
    td = env.reset()
    library = load_motions(ZEROTH01)
    states = {
        key: torch.cat([torch.from_numpy(motion.states[key]) for motion in library.values()])
        for key in library["standing"].states
    }
    gap = torch.cdist(td["joint_position"], states["joint_position"], p=1)
    gap += torch.cdist(td["joint_velocity"], states["joint_velocity"], p=1)
    nearest = gap.min(1)
    assert nearest.values.max() < 1e-3
    row = nearest.indices
    assert_close(td["base_angular_velocity"], states["base_angular_velocity"][row])
    seen, velocity = (
        rotate_inverse(orientation, speed)
        for orientation, speed in (
            (td["base_orientation"], td["base_linear_velocity"]),
            (states["base_orientation"][row], states["base_linear_velocity"][row]),
        )
    )
    assert_close(seen, velocity, atol=1e-5, rtol=0)
    assert tilt(td["base_orientation"]).max() < 1e-3
    angle = heading(td["base_orientation"])
    if turned:  # the mean of 256 random directions is rarely longer than 3 / sqrt(256)
        assert torch.polar(torch.ones(256), angle).mean().abs() < 0.19
    else:
        assert angle.abs().max() < 1e-6
    # MuJoCo's own speed of the lower foot, in the world: frames and signs must all be right.
    height, lower = td["feet_position"][..., 2].min(-1)
    assert_close(height, torch.zeros(256), atol=3e-4, rtol=0)
    rows = torch.arange(256)
    assert_close(td["feet_velocity"][rows, lower], torch.zeros(256, 3), atol=1e-4, rtol=0)
    assert_close(td["base_position"][:, :2], torch.zeros(256, 2))


def test_reference_starts_are_uniform_over_motions_and_phases(make_task):
    """Half of the starts stand; the rest spread evenly over six parts of the stride."""
    env = reference(make_task, 1536, motions=["standing", "forward_0.10"])
    td = env.reset()
    motion = torch.from_numpy(load_motions(ZEROTH01)["forward_0.10"].states["joint_position"])
    phase = torch.cdist(td["joint_position"], motion).min(1)
    walking = phase.values < 1e-3
    assert walking.float().mean().item() == pytest.approx(0.5, abs=0.05)  # 4 sigma
    stand = env.base_env.stand_position.expand(1536, 20)
    assert_close(td["joint_position"][~walking], stand[~walking])
    parts = torch.bincount(phase.indices[walking] // 10, minlength=6)
    expected = walking.sum() / 6
    assert ((parts - expected).square() / expected).sum() < 20.5  # chi2, 5 degrees, p = 0.001


def test_reference_noise_has_its_deviations_and_keeps_a_sole_on_the_floor(make_task):
    noise = {"joint_position": 0.05, "joint_velocity": 0.3}
    td = reference(make_task, motions=["standing"], **noise).reset()
    error = td["joint_position"] - torch.tensor(ZEROTH01.stand_position)
    assert error.std().item() == pytest.approx(0.05, rel=0.07)
    assert td["joint_velocity"].std().item() == pytest.approx(0.3, rel=0.07)
    td = reference(make_task, **noise).reset()
    corner = torch.tensor(ZEROTH01.sole_half_size).sum() * 0.4  # of a sole that leans by 0.4 rad
    height = td["feet_position"][..., 2].amin(-1)
    assert (height > 0).all()
    assert (height < corner).all()


def test_reference_starts_draw_the_same_stream_whoever_fell(make_task):
    starts = []
    for fallen in ([2], [0, 1, 2]):
        env = reference(make_task, 3, joint_position=0.05, heading=True)
        env.set_seed(4)
        td = env.reset()
        before = td["joint_position"].clone()
        rows = torch.zeros(3, 1, dtype=torch.bool)
        rows[fallen] = True
        td["_reset"] = rows
        td = env.reset(td)
        assert torch.equal(td["joint_position"][~rows[:, 0]], before[~rows[:, 0]])
        starts.append(torch.cat([td["joint_position"][2], td["base_orientation"][2]]))
    assert torch.equal(starts[0], starts[1])


def test_servos_can_halt_every_motion_they_start_in(make_task):
    """Close to dynamic stability: the standing pose as target catches the robot."""
    env = reference(make_task, 128, joint_position=0.05, joint_velocity=0.2)
    td, fell = env.reset(), torch.zeros(128, dtype=torch.bool)
    for _ in range(15):  # 0.6 s, two steps of the gaits
        td["action"] = torch.zeros(128, 20)
        td = env.step(td)["next"]
        fell |= body_contact(td, td)[:, 0]
    assert fell.sum() <= 2


@pytest.mark.parametrize(("values", "message"), [
    ({"motions": ["forward_0.10", "crawl"]}, r"motions must be of standing, .*, got crawl"),
    ({"motions": []}, r"motions must be of standing, .*, got none"),
    ({"joint_velocity": -1.0}, "joint_velocity must not be negative, got -1"),
])  # fmt: skip
def test_bad_reference_starts_are_refused(make_base, values, message):
    with pytest.raises(ValueError, match=message):
        ReferenceStart(make_base(), **values)


def test_scripted_start_is_the_state_given(make_task):
    position = torch.rand(4, 20) * 0.1
    speed = torch.rand(4, 3)
    states = {"joint_position": position, "base_linear_velocity": speed}
    td = make_task({**ACTION, "start": (ScriptedStart, {"states": states})}).reset()
    assert_close(td["joint_position"], position)
    assert_close(td["base_linear_velocity"], speed)


def test_unknown_state_is_refused(make_base):
    with pytest.raises(ValueError, match=r"states must be of joint_position.*got base_speed"):
        ScriptedStart(make_base(), states={"base_speed": torch.zeros(4, 3)})


def test_negative_noise_is_refused(make_base):
    with pytest.raises(ValueError, match="joint_velocity must not be negative, got -1"):
        NoisyStart(make_base(), joint_velocity=-1)


def lowest_corner(env, td) -> torch.Tensor:
    """Height of the lowest corner of the soles, from MuJoCo's own kinematics ``(N,)`` [m]."""
    base = env.base_env
    model, out = base.simulation.model, []
    half = torch.tensor([*base.robot.sole_half_size, 0.0], dtype=torch.float64)
    signs = torch.tensor([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)], dtype=torch.float64)
    for qpos in base.simulation.qpos.numpy():
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        sites = (data.site(f"{foot}_sole") for foot in base.robot.feet)
        heights = [s.xpos[2] + (signs * half).numpy() @ s.xmat.reshape(3, 3)[2] for s in sites]
        out.append(min(h.min() for h in heights))
    return torch.tensor(out)


@pytest.mark.parametrize("clearance", [None, [0.01, 0.03]])
def test_soles_begin_on_the_floor_or_hang_as_high_over_it_as_was_asked(make_task, clearance):
    values = {"joint_position": 0.17, "joint_velocity": 1.5, "clearance": clearance}
    env = make_task({**ACTION, "start": (NoisyStart, values)}, num_envs=64)
    check_env_specs(env)
    height = lowest_corner(env, env.reset())
    if clearance is None:
        assert_close(height, torch.zeros(64).double(), atol=1e-6, rtol=0)
        return
    assert ((height > 0.01 - 1e-6) & (height < 0.03 + 1e-6)).all()
    assert height.mean().item() == pytest.approx(0.02, abs=0.003)  # 0.0058 / 8, 4 sigma
    assert height.std().item() == pytest.approx(0.02 / 12**0.5, rel=0.25)


def test_clearance_below_the_floor_is_on_it(make_task):
    env = make_task({**ACTION, "start": (NoisyStart, {"clearance": [-0.02, 0.02]})}, num_envs=400)
    height = env.reset()["base_position"][:, 2]
    on_floor = height < height.min() + 1e-6
    assert 150 < on_floor.sum() < 250  # half of them, 5 sigma
    assert height.max() - height.min() == pytest.approx(0.02, abs=1e-3)


def test_bad_clearance_is_refused(make_base):
    with pytest.raises(ValueError, match=r"clearance must be \[smallest, largest\], got"):
        NoisyStart(make_base(), clearance=[0.02, 0.01])


@pytest.mark.parametrize("put", ["table", "compose"])
@pytest.mark.parametrize("late", ["noisy", "reference"])
def test_a_start_that_would_replace_a_part_of_another_is_refused(make_base, put, late):
    """The joints of standing in the pose of a fall."""
    base = make_base(num_envs=2)
    starts = {"reference": ReferenceStart(base), "noisy": NoisyStart(base)}
    if late == "reference":
        state = {"base_position": torch.zeros(2, 3)}
        starts = {"given": ScriptedStart(base, states=state), "reference": ReferenceStart(base)}
    if put == "table":
        env = make_env(base, starts)
    else:
        env = TransformedEnv(base, Compose(*reversed(starts.values())))
    with pytest.raises(ValueError, match=r"Start must act before the start .* got it after"):
        env.reset()
