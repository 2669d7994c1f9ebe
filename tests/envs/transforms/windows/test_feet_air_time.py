"""How long the feet are in the air."""

import math

import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import ScriptedStart
from zfall.envs.transforms.windows import FeetAirTime


def test_time_is_that_since_the_last_contact_whatever_the_contacts(make_base):
    """Counted backwards, step by step and foot by foot, in a random script."""
    base = make_base(num_envs=6)
    window = FeetAirTime(base)
    contacts = torch.rand(40, 6, 2) < 0.3
    window._reset(TensorDict(batch_size=[6]), TensorDict(batch_size=[6]))
    for step in range(40):
        td = window._call(TensorDict({"feet_contact": contacts[step]}, [6]))
        for world in range(6):
            for foot in range(2):
                count = 0
                while count <= step and not contacts[step - count, world, foot]:
                    count += 1
                expected = torch.tensor(0.04 * count)
                assert_close(td["feet_air_time"][world, foot], expected)


def test_robot_that_is_dropped_lands_after_the_time_of_free_fall(make_base):
    """h = g t^2 / 2; the soles of the standing pose are at the floor at a base height of 0.331."""
    base = make_base(num_envs=2, control_dt=0.02)
    fall = torch.tensor([0.1, 0.3])
    height = base.reset()["base_position"][0, 2] + fall
    start = torch.stack([torch.zeros(2), torch.zeros(2), height], -1)
    env = make_env(base, {
        "start": ScriptedStart(base, states={"base_position": start}),
        "action": JointPositionTarget(base, scale=1.0),
        "air": FeetAirTime(base),
    })  # fmt: skip
    check_env_specs(env)
    td, landed = env.reset(), torch.zeros(2)
    for _ in range(20):
        td["action"] = torch.zeros(2, 20)
        before = td["feet_air_time"].amax(-1)
        td = env.step(td)["next"]
        touched = (before > 0) & (td["feet_air_time"] == 0).all(-1) & (landed == 0)
        landed = torch.where(touched, before, landed)
    for way, time in zip(fall.tolist(), landed.tolist(), strict=True):
        assert 0 <= math.sqrt(2 * way / 9.81) - time < 0.03


def test_partial_reset_sets_only_its_rows_to_zero(make_base):
    window = FeetAirTime(make_base(num_envs=3))
    air = TensorDict({"feet_contact": torch.zeros(3, 2, dtype=torch.bool)}, [3])
    window._call(air.clone())
    rows = TensorDict({"_reset": torch.tensor([[True], [False], [False]])}, [3])
    td = window._reset(rows, TensorDict(batch_size=[3]))
    assert_close(td["feet_air_time"], torch.tensor([[0.0, 0.0], [0.04, 0.04], [0.04, 0.04]]))
    td = window._call(air.clone())
    assert_close(td["feet_air_time"], torch.tensor([[0.04, 0.04], [0.08, 0.08], [0.08, 0.08]]))
