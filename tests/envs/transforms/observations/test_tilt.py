"""Roll and pitch of an IMU."""

import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.estimation import TiltKalmanFilter
from zfall.envs.transforms.observations import ObservationNoise, TiltAngles


def down(roll: float, pitch: float) -> torch.Tensor:
    """Direction of gravity in the axes of a body that looks anywhere."""
    turn = Rotation.from_euler("ZYX", [2.0, pitch, roll])
    return torch.tensor(turn.inv().apply([[0.0, 0.0, -1.0]])).float()


def test_angles_are_those_of_gravity_as_measured_and_as_it_is():
    td = TensorDict({"projected_gravity": down(0.2, -0.3)}, [1])
    for method in (TiltAngles()._call, lambda td: TiltAngles()._reset(td, td)):
        out = method(td.clone())
        assert_close(out["tilt"], torch.tensor([[0.2, -0.3]]))
        assert_close(out["measured", "tilt"], torch.tensor([[0.2, -0.3]]))
    td["measured", "projected_gravity"] = down(0.25, -0.4)
    out = TiltAngles()._call(td)
    assert_close(out["tilt"], torch.tensor([[0.2, -0.3]]))
    assert_close(out["measured", "tilt"], torch.tensor([[0.25, -0.4]]))


def test_noise_of_the_angles_stands_after_them(make_base):
    base = make_base(num_envs=400)
    env = make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "tilt": TiltAngles(),
        "noise": ObservationNoise(base, std={"tilt": 0.01}),
    })  # fmt: skip
    check_env_specs(env)
    env.set_seed(0)
    td = env.reset()
    error = td["measured", "tilt"] - td["tilt"]
    assert error.std().item() == pytest.approx(0.01, rel=0.1)


def test_two_that_measure_the_same_are_refused(make_base):
    base = make_base()
    action = JointPositionTarget(base, scale=1.0)
    table = {"action": action, "kalman": TiltKalmanFilter(base), "tilt": TiltAngles()}
    with pytest.raises(
        ValueError, match="TiltAngles must be the only transform that measures tilt"
    ):
        check_env_specs(make_env(base, table))
