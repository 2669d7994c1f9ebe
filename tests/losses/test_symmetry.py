"""The mirror against simulation: a mirrored start and push give a mirrored motion."""

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.robots import ZEROTH01
from zfall.losses.symmetry import Mirror

KEYS = ["projected_gravity", "base_angular_velocity", "joint_position", "joint_velocity", "base_position",
        "base_linear_velocity", "com_velocity", "com_position", "base_orientation", "feet_position",
        "feet_force", "feet_contact", "angular_momentum", "linear_momentum", "joint_torque",
        "feet_velocity", "base_acceleration"]  # fmt: skip


def test_mirrored_start_gives_a_mirrored_motion(make_base):
    """World 1 is the mirror image of world 0: start, targets, and then all quantities.

    The published robot differs from its mirror image by a few millimetres and grams; the bound
    is 4 % of each quantity's spread over the motion, far below a wrong sign or place.
    """
    env = make_base(num_envs=2)
    mirror = Mirror(ZEROTH01, {"joints": ["joint_position"], "push": [("push", "force")]})
    step = 0.1 * torch.randn(20)
    start = env.stand_position + 0.5 * step
    image = mirror(TensorDict({"joints": torch.stack([start, step])}, batch_size=[2]))["joints"]
    speed = torch.tensor([[0.1, 0.3, 0.0], [0.1, -0.3, 0.0]])
    begin = {"joint_position": torch.stack([start, image[0]]), "base_linear_velocity": speed}
    td = env.reset(TensorDict({"start": begin}, batch_size=[2]))
    history = []
    for _ in range(8):
        td["target"] = env.stand_position + torch.stack([step, image[1]])
        td = env._step(td)
        history.append(td.clone())
    motion = torch.stack(history, 1)
    for key in KEYS:
        flat = motion[key].flatten(2).float()
        images = Mirror(ZEROTH01, {"x": [key]})(TensorDict({"x": flat[0]}, batch_size=[8]))["x"]
        spread = flat.abs().max().clamp_min(1e-3)
        assert ((images - flat[1]).abs().max() / spread) < 0.12, key


@pytest.mark.parametrize("key", [*KEYS, "action", "target", "last_action", ("push", "force")])
def test_mirror_of_the_mirror_is_the_original(key):
    sizes = {"base_orientation": 4, "feet_contact": 2}
    size = sizes.get(key, 6 if str(key).startswith("feet") else 3)
    if any(word in str(key) for word in ("joint", "action", "target")):
        size = 20
    td = TensorDict({"x": torch.randn(5, size)}, batch_size=[5])
    mirror = Mirror(ZEROTH01, {"x": [key]})
    assert_close(mirror(mirror(td))["x"], td["x"])


def test_vectors_of_several_quantities_are_mirrored_each_at_its_place():
    td = TensorDict({"x": torch.arange(1.0, 27.0)[None]}, batch_size=[1])
    mirror = Mirror(
        ZEROTH01, {"x": ["base_angular_velocity", "joint_position", "projected_gravity"]}
    )
    out = mirror(td)["x"][0]
    assert out[:3].tolist() == [-1.0, 2.0, -3.0]
    assert out[23:].tolist() == [24.0, -25.0, 26.0]
    assert out[3].item() == -(3 + 1 + 6)  # right hip yaw comes from the left one, seventh of all


def test_unknown_quantity_is_refused():
    with pytest.raises(ValueError, match="mirror image of 'wind' is not known"):
        Mirror(ZEROTH01, {"x": ["wind"]})
