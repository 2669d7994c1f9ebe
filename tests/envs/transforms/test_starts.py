"""How episodes begin."""

import mujoco
import pytest
import torch
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import NoisyStart, ScriptedStart

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
