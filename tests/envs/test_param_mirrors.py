"""Mirror images of physical parameters, by the physics of the robot."""

import pytest
import torch
from tensordict import TensorDict

from tests.envs.test_mirror import reflect
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import mirror_quantity
from zfall.envs.param_mirrors import param_mirrors
from zfall.robots import ZEROTH01, PushPoint

WORLDS = 48
OTHER_ELBOW = {"other_elbow": PushPoint(body="L_ARM_MIRROR_1", offset=None)}
SEEN = ("joint_velocity", "base_angular_velocity", "com_velocity")
SIZES = {
    "link_mass": (0.5, 2.0),
    "com_offset": (-0.03, 0.03),
    "payload": (0.0, 0.5),
    "joint_friction_loss": (0.0, 5.0),
    "joint_damping": (0.0, 5.0),
    "joint_armature": (0.3, 3.0),
    "servo_stiffness": (0.3, 2.0),
    "servo_torque_limit": (0.0, 1.0),
    "joint_zero_offset": (-0.1, 0.1),
    "slope": (-0.5, 0.5),
    "floor_friction": (0.2, 2.0),
    "foot_friction": (0.0, 0.3),
    "battery_voltage": (0.3, 1.0),
}


@pytest.fixture(scope="module")
def env() -> HumanoidEnv:
    return HumanoidEnv(num_envs=WORLDS, control_dt=0.02, threads=1, push_points=OTHER_ELBOW)


def image(env: HumanoidEnv, name: str, value: torch.Tensor) -> torch.Tensor:
    key = f"params/{name}"
    index, signs = mirror_quantity(env.robot, key, param_mirrors(env, [key]))
    return value[:, list(index)] * torch.tensor(list(signs))


def after(env: HumanoidEnv, start: dict, target: torch.Tensor, params: dict) -> dict:
    """Velocities three control steps later."""
    env.set_physics_params(TensorDict(params, [WORLDS]))
    td = env.reset(TensorDict({"start": start}, [WORLDS]))
    for _ in range(3):
        td["target"] = target
        td = env.step(td)["next"]
    return {key: td[key].clone() for key in SEEN}


def test_every_parameter_of_the_physics_is_known(env):
    assert {*env.physics_param_spec.keys()} == {*SIZES}


@pytest.mark.parametrize("name", list(SIZES))
def test_what_a_parameter_does_in_the_mirror_is_the_mirror_image(env, name):
    """Against what the nominal one does, so that no side of the robot counts more than the other.

    A wrong sign or place is off by more than the effect itself.
    """
    torch.manual_seed(0)
    joints = torch.tensor(ZEROTH01.stand_position) + 0.1 * torch.randn(WORLDS, 20)
    start = {
        "joint_position": joints,
        "joint_velocity": torch.randn(WORLDS, 20),
        "base_linear_velocity": 0.3 * torch.randn(WORLDS, 3),
        "base_angular_velocity": torch.randn(WORLDS, 3),
    }
    if name == "floor_friction":  # that of all but the feet
        lying = torch.tensor([0.5**0.5, 0.0, 0.5**0.5, 0.0])
        start["base_orientation"] = lying.expand(WORLDS, 4).clone()
    target = joints + 0.2 * torch.randn(WORLDS, 20)
    low, high = SIZES[name]
    value = low + (high - low) * torch.rand(env.physics_param_spec[name].shape)
    there = {key: reflect(key, x) for key, x in start.items()}
    worlds = [(start, target, value), (there, reflect("target", target), image(env, name, value))]
    nominal = {name: env.parameters.values[name].clone()}
    here, other = (
        [after(env, *world, {name: x}), after(env, *world, nominal)] for *world, x in worlds
    )
    effects = [
        {key: with_it[key] - without[key] for key in SEEN} for with_it, without in (here, other)
    ]
    away = size = 0.0
    for key in SEEN:
        away += (reflect(key, effects[0][key]) - effects[1][key]).norm(dim=1).median()
        size += effects[1][key].norm(dim=1).median()
    assert size > 0.01
    assert away < 0.2 * size, f"{name}: {away:.4f} of {size:.4f}"


@pytest.mark.parametrize("name", list(SIZES))
def test_twice_in_the_mirror_is_as_before(env, name):
    value = torch.randn(env.physics_param_spec[name].shape)
    torch.testing.assert_close(image(env, name, image(env, name, value)), value)


def test_a_push_point_of_one_side_alone_is_refused(make_base):
    with pytest.raises(ValueError, match=r"other side of elbow .* add one to env.base_env.push_p"):
        param_mirrors(make_base(), ["params/payload"])
