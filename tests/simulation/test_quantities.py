"""The table of quantities, and what follows from it."""

from dataclasses import replace
from pathlib import Path

import torch

from zfall.robots import ZEROTH01
from zfall.simulation import quantities
from zfall.simulation.quantities import BALL, QUANTITIES, markdown_table, observation_spec

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "quantities.md"


def test_the_page_shows_the_table():
    assert markdown_table() in PAGE.read_text()


def test_the_env_writes_every_quantity_in_the_shape_and_type_of_the_table(make_base):
    env = make_base(num_envs=3)
    td = env.reset()
    for quantity in (*QUANTITIES, quantities.FLAG):
        assert td[quantity.name].shape == (3, *quantity.size(env.robot)), quantity.name
        assert td[quantity.name].dtype == quantity.dtype, quantity.name
    flags = {"done", "terminated", "truncated"}
    assert set(td.keys()) - flags == {*quantities.NAMES, "diverged"}


def test_shapes_follow_the_robot():
    one_armed = ZEROTH01.joints[:-4]
    robot = replace(ZEROTH01, joints=one_armed, regions=ZEROTH01.regions[:5], postures={})
    spec = observation_spec(robot, 7, BALL)
    assert spec["joint_torque"].shape == (7, 16)
    assert spec["contact_force_peak"].shape == (7, 5)
    assert spec["feet_corner_force"].shape == (7, 2, 4)
    assert spec["ball", "velocity"].shape == (7, 3)
    assert spec["feet_contact"].dtype == torch.bool


def test_a_state_is_positions_and_velocities_of_joints_and_base(make_base):
    """Together they fill MuJoCo's state: each component once."""
    env = make_base(num_envs=1)
    sizes = {q.name: q.size(env.robot)[0] for q in QUANTITIES if q.place is not None}
    assert tuple(sizes) == quantities.STATE_KEYS
    for array, size in (("qpos", env.simulation.model.nq), ("qvel", env.simulation.model.nv)):
        assert size == sum(sizes[k] for k, p in quantities.PLACES.items() if p.array == array)
