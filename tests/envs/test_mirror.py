"""Mirror images: by the physics of the robot, and of known quantities."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import mirror_action, mirror_quantity, mirror_vector, mirrors_of
from zfall.envs.transforms.windows import LargestSoFar
from zfall.robots import ZEROTH01
from zfall.rotations import rotate

KEYS = (
    "joint_position",
    "joint_velocity",
    "joint_torque",
    "base_position",
    "base_orientation",
    "projected_gravity",
    "base_linear_velocity",
    "base_angular_velocity",
    "base_acceleration",
    "com_position",
    "com_velocity",
    "linear_momentum",
    "angular_momentum",
    "feet_position",
    "feet_orientation",
    "feet_velocity",
    "feet_force",
    "feet_cop",
    "feet_corner_force",
    "feet_contact",
    "contact_force_peak",
    "contact_impulse",
)


def reflect(name: str, value: torch.Tensor) -> torch.Tensor:
    index, sign = mirror_quantity(ZEROTH01, name)
    flat = value.flatten(1).float()[:, list(index)] * torch.tensor(list(sign))
    return flat.reshape(value.shape)


def rollout(
    start: dict[str, torch.Tensor], target: torch.Tensor, force: torch.Tensor
) -> TensorDict:
    """Two control steps of some worlds, pushed at the torso."""
    env = HumanoidEnv(num_envs=len(target), control_dt=0.02, threads=1)
    td = env.reset(TensorDict({"start": start}, [len(target)]))
    wrench = torch.zeros(len(target), env.substeps, env.num_bodies, 6)
    wrench[:, :, env.push_targets["torso"], :3] = force[:, None]
    for _ in range(2):
        td["target"], td["push", "wrench"] = target, wrench
        td = env.step(td)["next"]
    return td


def test_physics_in_the_mirror_is_the_mirror_image():
    """The robot is symmetric to some per cent: a wrong sign or place is off by twice the value."""
    torch.manual_seed(0)
    num = 64
    stand = torch.tensor(ZEROTH01.stand_position)
    joints = stand + 0.1 * torch.randn(num, 20)
    turn = 0.1 * torch.randn(num, 3)
    start = {
        "joint_position": joints,
        "joint_velocity": torch.randn(num, 20),
        "base_orientation": torch.nn.functional.normalize(
            torch.cat([torch.ones(num, 1), turn], -1), dim=-1
        ),
        "base_linear_velocity": 0.3 * torch.randn(num, 3),
        "base_angular_velocity": torch.randn(num, 3),
    }
    target, force = joints + 0.2 * torch.randn(num, 20), 20 * torch.randn(num, 3)
    there = rollout(
        {key: reflect(key, value) for key, value in start.items()},
        reflect("target", target),
        reflect("push/force", force),
    )
    here = rollout(start, target, force)
    for key in KEYS:
        image, value = reflect(key, here[key]), there[key].float()
        away = (image - value).flatten(1).norm(dim=1).median()
        size = (value - value.mean(0)).flatten(1).norm(dim=1).median()
        assert away < 0.15 * size + 1e-3, f"{key}: {away:.4f} of {size:.4f}"


@pytest.mark.parametrize("key", [*KEYS, "command", "tilt", "imu_orientation", "feet_load"])
def test_twice_in_the_mirror_is_as_before(key):
    index, _ = mirror_quantity(ZEROTH01, key)
    value = torch.randn(3, len(list(index)))
    assert_close(reflect(key, reflect(key, value)), value)


class Wind(Transform):
    """Brings quantities that no general code knows."""

    mirror_signs = {"wind": (1.0, -1.0, 1.0), "noise_level": (1.0,)}
    mirror_like = {"contact_force_max": "contact_force_peak", "last_wind": "wind"}


@pytest.mark.parametrize(
    ("key", "like"),
    [
        ("wind", "push/force"),
        ("last_wind", "push/force"),
        ("noise_level", "base_height"),
        ("contact_force_max", "contact_force_peak"),
    ],
)
def test_a_transform_says_how_its_own_quantities_are_mirrored(key, like):
    declared = mirrors_of([Transform(), Wind()])
    index, sign = mirror_quantity(ZEROTH01, key, declared)
    expected = mirror_quantity(ZEROTH01, like)
    assert (list(index), list(sign)) == (list(expected[0]), list(expected[1]))
    size = len(list(index))
    mirror = mirror_vector(ZEROTH01, {key: slice(0, size)}, torch.zeros(20, 2), declared=declared)
    value = torch.randn(3, size)
    assert_close(mirror(value), value[:, list(index)] * torch.tensor(list(sign)))
    with pytest.raises(ValueError, match=f"got {key}"):
        mirror_quantity(ZEROTH01, key)


def test_the_largest_so_far_is_mirrored_as_what_it_follows(make_base):
    largest = LargestSoFar(make_base(), keys={"contact_force_peak": "hardest"})
    declared = mirrors_of([largest])
    index, _ = mirror_quantity(ZEROTH01, "hardest", declared)
    assert list(index) == list(mirror_quantity(ZEROTH01, "contact_force_peak")[0])


def test_a_turned_vector_in_the_mirror_is_the_mirrored_one_turned_there():
    """``M (R v) = R' (M v)``: holds for a quaternion only with the signs of an axial axis."""
    turn = torch.nn.functional.normalize(torch.randn(10, 4), dim=-1)
    vector = torch.randn(10, 3)
    image = reflect("base_position", rotate(turn, vector))
    there = rotate(reflect("base_orientation", turn), reflect("base_position", vector))
    assert_close(image, there)


def test_vector_in_units_of_its_ranges():
    """Joints of ranges of their own, onto [-1, 1]: out of there, mirrored, cut, and back."""
    low, high = -1.0 - 0.1 * torch.arange(20), 0.5 + 0.2 * torch.arange(20).flip(0)
    factor = 2.0 / (high - low)
    summand = -1.0 - factor * low
    ranges = torch.stack([low, high], -1)
    affine = {"joint_position": (factor, summand)}
    mirror = mirror_vector(ZEROTH01, {"joint_position": slice(0, 20)}, ranges, affine)
    joints = low + (high - low) * torch.rand(50, 20)
    image = reflect("joint_position", joints)
    cut = (image < low) | (image > high)
    assert 0.1 < cut.float().mean() < 0.7
    expected = factor * torch.clamp(image, low, high) + summand
    assert_close(mirror(factor * joints + summand), expected, atol=1e-5, rtol=0)


def test_angles_stay_in_the_range_of_the_other_side():
    ranges = torch.tensor([[-0.2, 0.1]]).expand(20, 2)
    mirror = mirror_vector(ZEROTH01, {"target": slice(0, 20)}, ranges)
    image = mirror(torch.full((1, 20), 0.2))
    flips = torch.tensor(ZEROTH01.mirror_sign) < 0
    assert_close(image[0], torch.where(flips, -0.2, 0.1))


def test_action_of_the_legs_is_mirrored_within_the_legs():
    mirror = mirror_action(ZEROTH01, 12)
    names = list(ZEROTH01.legs)
    action = torch.zeros(12)
    action[names.index("left_knee_pitch")], action[names.index("left_hip_roll")] = 1.0, 2.0
    image = mirror(action)
    assert image[names.index("right_knee_pitch")] == 1.0
    assert image[names.index("right_hip_roll")] == -2.0
    assert image.abs().sum() == 3.0


def test_faults_name_what_is_known():
    with pytest.raises(ValueError, match="must be one of .*feet_position.*got weather"):
        mirror_quantity(ZEROTH01, "weather")
    with pytest.raises(ValueError, match="must have 20 joints, or the 12 of the legs; got 7"):
        mirror_action(ZEROTH01, 7)
    with pytest.raises(ValueError, match="projected_gravity has 3 components, got 2"):
        mirror_vector(ZEROTH01, {"projected_gravity": slice(0, 2)}, torch.zeros(20, 2))
