"""Named quantities from made-up sensor values, by hand."""

from dataclasses import replace

import pytest
import torch
from torch.testing import assert_close

from zfall.simulation.model import sensor_slices
from zfall.simulation.read_quantities import QuantityReader


@pytest.fixture()
def read(make_base):
    """Quantities of one world from sensor values set by name, zero elsewhere."""
    env = make_base(num_envs=1)
    slices = sensor_slices(env.simulation.model)

    def build(steps: dict[int, dict[str, list[float]]]):
        values = torch.zeros(1, env.substeps, env.simulation.model.nsensordata, dtype=torch.float64)
        for step, sensors in steps.items():
            for name, value in sensors.items():
                values[0, step, slices[name]] = torch.tensor(value, dtype=torch.float64)
        read = env._read(env.simulation.qpos, env.simulation.qvel, values)
        return env, {key: value[0] for key, value in read.items()}

    return build


def test_peak_force_adds_the_parts_of_a_region_as_vectors_and_keeps_the_largest_step(read):
    """3 N and 4 N at right angles are 5 N; the same forces in two steps are not."""
    trunk, hip = "contact_force_peak/torso/trunk", "contact_force_peak/torso/left_hip_servo"
    env, td = read({2: {trunk: [3.0, 0, 0], hip: [0, 4.0, 0]}, 5: {trunk: [4.5, 0, 0]}})
    expected = torch.zeros(14)
    expected[env.regions.index("torso")] = 5.0
    assert_close(td["contact_force_peak"], expected)
    env, td = read({2: {trunk: [3.0, 0, 0]}, 5: {hip: [0, 4.0, 0]}})
    assert td["contact_force_peak"].max().item() == 4.0


def test_contact_impulse_is_the_force_over_time(read):
    """5 N for one physics step of ten, 4.5 N for another."""
    trunk, hip = "contact_force_peak/torso/trunk", "contact_force_peak/torso/left_hip_servo"
    env, td = read({2: {trunk: [3.0, 0, 0], hip: [0, 4.0, 0]}, 5: {trunk: [4.5, 0, 0]}})
    expected = torch.zeros(14)
    expected[env.regions.index("torso")] = 9.5 * env.control_dt / env.substeps
    assert_close(td["contact_impulse"], expected)


def test_acceleration_is_the_mean_and_its_peak_the_largest_norm(read):
    _, td = read(
        {0: {"base_acceleration": [10.0, 0, 0]}, 9: {"base_acceleration": [0, -30.0, 40.0]}}
    )
    assert_close(td["base_acceleration"], torch.tensor([1.0, -3.0, 4.0]))  # over ten steps
    assert td["base_acceleration_peak"].item() == 50.0


def test_force_on_a_foot_is_the_reaction_of_the_last_step(read):
    contact = [1.0, 0.0, 0.0, -16.0, 0.0, 0.0, 0.0]
    _, td = read({9: {"feet_contact/right": contact}, 3: {"feet_contact/left": contact}})
    assert_close(td["feet_force"], torch.tensor([[0.0, 0, 0], [0, 0, 16.0]]))
    assert td["feet_contact"].tolist() == [False, True]


def test_a_foot_that_touches_without_force_has_no_center_of_pressure(read):
    """The center that MuJoCo weighs by force is the world's origin then, here 2.2 m away."""
    sole = {"feet_position/left": [2.0, 1.0, 0.0], "feet_orientation/left": [1.0, 0, 0, 0]}
    grazing = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    _, td = read({9: sole | {"feet_contact/left": grazing}})
    assert td["feet_contact"].tolist() == [True, False]
    assert_close(td["feet_cop"], torch.zeros(2, 2))
    pressed = [1.0, 0.0, 0.0, -16.0, 2.01, 0.98, 0.0]
    _, td = read({9: sole | {"feet_contact/left": pressed}})
    assert_close(td["feet_cop"], torch.tensor([[0.01, -0.02], [0.0, 0.0]]), atol=1e-6, rtol=0)


@pytest.mark.parametrize(("sensor", "key"), [
    ("joint_torque/left_knee_pitch", "joint_torque_peak"),
    ("base_acceleration", "base_acceleration_peak"),
    ("contact_force_peak/torso/trunk", "contact_force_peak"),
])  # fmt: skip
@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_peaks_hide_nothing_that_is_not_finite(read, sensor, key, value):
    """No comparison holds for NaN; numbers follow it here, in later steps."""
    size = 1 if sensor.startswith("joint") else 3
    steps = {step: {sensor: [1.0] * size} for step in range(10)}
    steps[4] = {sensor: [value] * size}
    _, td = read(steps)
    assert not td[key].isfinite().all()
    others = {"joint_torque_peak", "base_acceleration_peak", "contact_force_peak"} - {key}
    assert all(td[other].isfinite().all() for other in others)


def test_gravity_is_that_of_each_world_seen_from_its_base(make_base):
    """Turned to the left by a quarter, a base has its x axis along the world's y."""
    env = make_base(num_envs=3)
    qpos = env.simulation.qpos.clone()
    qpos[:, 3:7] = torch.tensor([0.5**0.5, 0.0, 0.0, 0.5**0.5])
    gravity = torch.tensor([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8], [0.0, -1.0, 0.0]])
    values = torch.zeros(3, env.substeps, env.simulation.model.nsensordata, dtype=torch.float64)
    read = env._read(qpos, env.simulation.qvel, values, gravity)
    expected = torch.tensor([[0.0, 0.0, -1.0], [0.0, -0.6, -0.8], [-1.0, 0.0, 0.0]])
    assert_close(read["projected_gravity"], expected)


@pytest.mark.parametrize(
    "name",
    [
        "joint_torque/left_knee_pitch",
        "feet_contact/left",
        "com_velocity",
        "contact_force_peak/torso/trunk",
    ],
)
def test_a_sensor_of_another_size_is_refused(make_base, name):
    """It would be read beyond its end, and be the next sensor's values."""
    env = make_base(num_envs=1)
    sensors = sensor_slices(env.simulation.model)
    sensors[name] = slice(sensors[name].start, sensors[name].stop + 1)
    with pytest.raises(ValueError, match=f"sensor {name} must have . values, got"):
        QuantityReader(env.robot, env.simulation.model, sensors, mass=1.0, control_dt=0.04)


def test_a_sole_has_as_many_corners_as_its_robot_says(make_base):
    env = make_base(num_envs=2)
    robot = replace(env.robot, corners=env.robot.corners[:3])
    sensors = sensor_slices(env.simulation.model)
    read = QuantityReader(robot, env.simulation.model, sensors, mass=1.0, control_dt=0.04)
    values = torch.zeros(2, 10, env.simulation.model.nsensordata, dtype=torch.float64)
    for corner, force in zip(robot.corners, (1.0, 2.0, 3.0), strict=True):
        values[:, -1, sensors[f"feet_corner_force/right/{corner}"].start + 2] = -force
    forces = read(env.simulation.qpos, env.simulation.qvel, values)["feet_corner_force"]
    assert forces.tolist() == [[[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]] * 2


def test_worlds_to_read_come_with_what_the_others_are(make_base):
    env = make_base(num_envs=2)
    states = env.simulation.qpos, env.simulation.qvel
    sensors = torch.zeros(2, env.substeps, env.simulation.model.nsensordata, dtype=torch.float64)
    with pytest.raises(ValueError, match="index and before must be given together"):
        env._read(*states, sensors, index=torch.tensor([1]))
    everything = env._read(*states, sensors)
    sensors[:] = torch.arange(1.0, sensors.shape[-1] + 1, dtype=torch.float64)
    part = env._read(*states, sensors, index=torch.tensor([1]), before=everything)
    whole = env._read(*states, sensors)
    for key, value in part.items():
        assert_close(value[0], everything[key][0], rtol=0, atol=0)
        assert_close(value[1], whole[key][1], rtol=0, atol=0)
