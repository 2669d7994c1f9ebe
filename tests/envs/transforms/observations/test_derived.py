"""Derived quantities against scipy's rotations."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import (
    BasePose,
    FeetInBase,
    ImuOrientation,
    ObservationNoise,
    ObservationVector,
    OrientationToHeading,
)
from zfall.envs.transforms.starts import NoisyStart

WORLDS = 64


@pytest.fixture
def turned():
    """Bases anywhere, turned in any way, and the rotations by scipy."""
    rotation = Rotation.random(WORLDS, random_state=0)
    td = TensorDict(
        {
            "base_position": torch.randn(WORLDS, 3),
            "base_orientation": torch.from_numpy(rotation.as_quat()[:, [3, 0, 1, 2]]).float(),
            "feet_position": torch.randn(WORLDS, 2, 3),
            "feet_force": torch.randn(WORLDS, 2, 3),
        },
        [WORLDS],
    )
    return td, rotation


def test_roll_and_pitch_are_angles_of_the_sequence_z_x_y(turned):
    td, rotation = turned
    out = BasePose()._call(td)
    expected = rotation.as_euler("ZXY")[:, 1:]
    np.testing.assert_allclose(
        out["roll_pitch"].numpy(), expected, atol=2e-3
    )  # asin near 90 degrees
    assert_close(out["base_height"], td["base_position"][:, 2:])


@pytest.mark.parametrize(("axis", "expected"), [("x", [0.3, 0.0]), ("y", [0.0, 0.3])])
def test_roll_is_to_the_right_and_pitch_forward_whatever_the_heading(axis, expected):
    """The right-hand rule about x forward lowers the right side, about y to the left the nose."""
    turn = Rotation.from_euler("Z" + axis.upper(), [2.0, 0.3])
    quaternion = torch.tensor(turn.as_quat()[[3, 0, 1, 2]])[None].float()
    values = {"base_position": torch.zeros(1, 3), "base_orientation": quaternion}
    out = BasePose()._call(TensorDict(values, [1]))
    assert out["roll_pitch"][0].tolist() == pytest.approx(expected, abs=1e-6)


def test_feet_are_seen_from_the_base(turned):
    td, rotation = turned
    out = FeetInBase()._call(td)
    away = (td["feet_position"] - td["base_position"][:, None]).numpy()
    for foot in range(2):
        expected = rotation.inv().apply(away[:, foot])
        np.testing.assert_allclose(out["feet_in_base"][:, foot].numpy(), expected, atol=1e-5)
    assert_close(out["feet_load"], td["feet_force"][..., 2])


def test_imu_says_the_same_rotation_with_one_sign(turned):
    td, rotation = turned
    td["base_orientation"][::2] *= -1
    out = ImuOrientation()._call(td)["imu_orientation"]
    assert (out[:, 0] >= 0).all()
    back = Rotation.from_quat(out.numpy()[:, [1, 2, 3, 0]])
    assert (rotation.inv() * back).magnitude().max() < 1e-5


def test_the_orientation_to_the_heading_is_turned_back_by_it(turned):
    td, rotation = turned
    angle = torch.linspace(-3.0, 3.0, len(td))[:, None]
    td["commanded_heading"] = angle
    out = OrientationToHeading()._call(td)["imu_orientation"]
    assert (out[:, 0] >= 0).all()
    expected = Rotation.from_euler("z", -angle.numpy()) * rotation
    found = Rotation.from_quat(out.numpy()[:, [1, 2, 3, 0]])
    assert (expected.inv() * found).magnitude().max() < 1e-5


def build(base, noise: bool):
    table = {
        "start": NoisyStart(base, joint_position=0.1),
        "action": JointPositionTarget(base, scale=1.0),
        "pose": BasePose(),
        "feet": FeetInBase(),
        "imu": ImuOrientation(),
        "vector": ObservationVector(keys=["roll_pitch"], out_key="observation", measured=True),
    }
    if noise:
        std = {"base_orientation": 0.05, "feet_force": 1.0}
        table = {"noise": ObservationNoise(base, std=std)} | table
    return make_env(base, table)


@pytest.mark.parametrize("noise", [False, True])
def test_what_follows_from_the_measured_is_measured_too(make_base, noise):
    env = build(make_base(num_envs=3), noise)
    check_env_specs(env)
    td = env.reset()
    td["action"] = torch.zeros(3, 20)
    td = env.step(td)["next"]
    if not noise:
        assert "measured" not in td.keys()
        return
    measured = td["measured"]
    direct = BasePose()._call(
        TensorDict(
            {
                "base_position": td["base_position"],
                "base_orientation": measured["base_orientation"],
            },
            [3],
        )
    )
    assert_close(measured["roll_pitch"], direct["roll_pitch"])
    assert_close(td["observation"], direct["roll_pitch"])
    assert (td["roll_pitch"] - measured["roll_pitch"]).abs().max() > 1e-3
    assert_close(measured["feet_load"], measured["feet_force"][..., 2])
    assert "base_height" not in measured.keys()  # nobody measured the position


def test_noise_on_what_it_reads_must_come_before_it(make_base):
    base = make_base()
    noise = ObservationNoise(base, std={"base_orientation": 0.1})
    with pytest.raises(ValueError, match=r"noise must come before pose, which reads base_orient"):
        make_env(base, {"pose": BasePose(), "noise": noise})
