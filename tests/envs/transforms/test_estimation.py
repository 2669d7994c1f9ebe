"""Estimates: against filterpy world by world, and against the truth."""

import math

import numpy as np
import pytest
import torch
from filterpy.kalman import KalmanFilter
from scipy.spatial.transform import Rotation
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.estimation import (
    JointVelocityKalmanFilter,
    MahonyFilter,
    NumericalVelocity,
    TiltKalmanFilter,
    steady_update,
)
from zfall.envs.transforms.estimation.tilt_laws import OnSphere
from zfall.envs.transforms.observations import ObservationNoise, ObservationVector
from zfall.rotations import roll_and_pitch, rotate_inverse
from zfall.static_checks import check_nodes

DT = 0.02


def roll_of(angle: torch.Tensor) -> torch.Tensor:
    """Orientations ``(N, 4)`` rolled by an angle ``(N,)``."""
    zero = torch.zeros_like(angle)
    return torch.stack([torch.cos(angle / 2), torch.sin(angle / 2), zero, zero], -1)


def imu(angle: torch.Tensor, rate: torch.Tensor) -> TensorDict:
    """What a body that rolls in place measures."""
    zero = torch.zeros_like(angle)
    gravity = torch.tensor([0.0, 0.0, 9.81]).expand(len(angle), 3)
    return TensorDict(
        {
            "base_orientation": roll_of(angle),
            "base_angular_velocity": torch.stack([rate, zero, zero], -1),
            "base_acceleration": rotate_inverse(roll_of(angle), gravity),
            "projected_gravity": rotate_inverse(roll_of(angle), -gravity / 9.81),
        },
        [len(angle)],
    )


def test_roll_and_pitch_are_those_of_the_rotations_about_x_and_y():
    assert_close(
        roll_and_pitch(imu(torch.tensor([0.3]), torch.zeros(1))["base_acceleration"]),
        torch.tensor([[0.3, 0.0]]),
    )
    half = torch.tensor(0.25)
    forward = torch.stack([half.cos(), 0 * half, half.sin(), 0 * half])[None]  # nose down by 0.5
    up = rotate_inverse(forward, torch.tensor([[0.0, 0.0, 1.0]]))
    assert_close(roll_and_pitch(up), torch.tensor([[0.0, 0.5]]))
    upside_down = roll_of(torch.tensor([math.pi - 0.1]))
    up = rotate_inverse(upside_down, torch.tensor([[0.0, 0.0, 1.0]]))
    assert_close(roll_and_pitch(up), torch.tensor([[math.pi - 0.1, 0.0]]), atol=1e-5, rtol=0)


def test_steady_gain_is_the_closed_form_of_a_random_walk():
    """q = r = 1: P = (1 + sqrt 5) / 2 before the update, K = P / (P + 1)."""
    kalman = KalmanFilter(dim_x=1, dim_z=1)
    kalman.H = np.ones((1, 1))
    matrix = steady_update(kalman)
    prior = (1 + 5**0.5) / 2
    gain = prior / (prior + 1)
    assert_close(matrix, torch.tensor([[1 - gain], [gain]]))


def test_filter_that_never_settles_is_refused():
    """A constant, measured ever better: its gain is 1 / n."""
    kalman = KalmanFilter(dim_x=1, dim_z=1)
    kalman.H, kalman.Q = np.ones((1, 1)), np.zeros((1, 1))
    with pytest.raises(ValueError, match=r"must let the filter settle"):
        steady_update(kalman)


def test_tilt_of_all_worlds_equals_filterpy_in_each(make_base):
    base = make_base(num_envs=3, control_dt=DT)
    transform = TiltKalmanFilter(base)
    start = 0.2 * torch.randn(3)
    td = transform._reset(TensorDict(batch_size=[3]), imu(start, torch.zeros(3)))
    alone = []
    for world in range(3):
        kalman = TiltKalmanFilter(base).kalman
        kalman.x = np.array([[start[world].item()], [0.0]])
        alone.append(kalman)
    before = torch.zeros(3)
    for _ in range(20):
        angle, rate = 0.3 * torch.randn(3), torch.randn(3)
        td = transform._call(imu(angle, rate))
        for world, kalman in enumerate(alone):
            kalman.predict_steadystate(np.array([[(rate + before)[world].item() / 2]]))
            kalman.update_steadystate(np.array([[angle[world].item()]]))
            assert td["measured", "tilt"][world, 0].item() == pytest.approx(
                kalman.x[0, 0], abs=1e-5
            )
            assert td["measured", "gyro_bias"][world, 0].item() == pytest.approx(
                kalman.x[1, 0], abs=1e-5
            )
        before = rate
    assert_close(td["tilt"][:, 0], angle)


def test_tilt_and_bias_come_nearer_to_the_truth_than_either_sensor(make_base):
    """A body that sways, under a gyro with a bias and a shaken accelerometer."""
    dt = 0.04
    base = make_base(num_envs=64, control_dt=dt)
    transform = TiltKalmanFilter(base, gyro_std=0.02, bias_rate=0.01, angle_std=0.1)
    phase = 2 * math.pi * torch.rand(64)
    bias = 0.05 * torch.randn(64)
    transform._reset(TensorDict(batch_size=[64]), imu(0.3 * torch.sin(phase), torch.zeros(64)))
    errors, raw, integrated = [], [], 0.3 * torch.sin(phase)
    for step in range(1, 401):
        angle = 0.3 * torch.sin(3 * step * dt + phase)
        td = imu(angle, 0.9 * torch.cos(3 * step * dt + phase))
        gyro = td["base_angular_velocity"].clone()
        gyro[:, 0] += bias + 0.02 * torch.randn(64)
        integrated = integrated + dt * gyro[:, 0]
        td["measured", "base_angular_velocity"] = gyro
        td["measured", "base_acceleration"] = td["base_acceleration"] + torch.randn(64, 3)
        td = transform._call(td)
        errors.append(td["measured", "tilt"][:, 0] - angle)
        raw.append(roll_and_pitch(td["measured", "base_acceleration"])[:, 0] - angle)
    error, raw_error = (torch.stack(e[200:]).square().mean().sqrt() for e in (errors, raw))
    assert error < 0.3 * raw_error
    assert error < 0.3 * (integrated - angle).square().mean().sqrt()
    left = td["measured", "gyro_bias"][:, 0] - bias
    assert left.square().mean().sqrt() < 0.4 * bias.square().mean().sqrt()


def test_tilt_of_the_robot_itself_is_found_while_it_moves(make_base):
    """Axes and signs of the simulated IMU; a twitching robot topples, up to 0.5 rad."""
    base = make_base(num_envs=16, control_dt=DT)
    action = JointPositionTarget(base, scale=0.3)
    env = make_env(base, {"action": action, "tilt": TiltKalmanFilter(base)})
    td = env.reset()
    errors, raw, true = [], [], []
    for _ in range(40):
        td["action"] = torch.randn(16, 20)
        td = env.step(td)["next"]
        upright = td["tilt"].abs().amax(-1) < 0.5
        errors.append((td["measured", "tilt"] - td["tilt"])[upright])
        raw.append((roll_and_pitch(td["base_acceleration"]) - td["tilt"])[upright])
        true.append(td["tilt"][upright])
    error, raw_error, moved = (torch.cat(e).square().mean(0).sqrt() for e in (errors, raw, true))
    assert (error < 0.5 * moved).all()
    assert (error < 0.3 * raw_error).all()


def test_angle_follows_through_a_whole_turn(make_base):
    """The accelerometer's angle jumps from pi to -pi: the estimate does not."""
    base = make_base(num_envs=1, control_dt=DT)
    transform = TiltKalmanFilter(base)
    transform._reset(TensorDict(batch_size=[1]), imu(torch.tensor([3.0]), torch.tensor([1.0])))
    for step in range(1, 21):
        angle = torch.tensor([3.0 + step * DT])
        td = transform._call(imu(angle, torch.tensor([1.0])))
        assert_close(td["measured", "tilt"][:, 0], angle, atol=1e-4, rtol=0)


def turned_imu(body: Rotation, rate: np.ndarray) -> TensorDict:
    """What bodies with these orientations and rates measure at rest ``(N, 3)``."""
    up = torch.tensor(body.inv().apply([0.0, 0.0, 1.0])).float()
    quaternion = torch.tensor(body.as_quat()[:, [3, 0, 1, 2]]).float()
    return TensorDict(
        {
            "base_orientation": quaternion,
            "base_angular_velocity": torch.tensor(rate).float(),
            "base_acceleration": 9.81 * up,
            "projected_gravity": -up,
        },
        [len(rate)],
    )


def test_mahony_filter_is_the_kalman_filter_for_small_angles(make_base):
    """Sway of 0.02 rad about both axes under a gyro with a bias: to second order in the tilt."""
    base = make_base(num_envs=4, control_dt=DT)
    filters = [cls(base, angle_std=0.05) for cls in (TiltKalmanFilter, MahonyFilter)]
    phase, bias = 6 * np.random.default_rng(0).random((4, 2)), 0.03
    for step in range(101):
        turn = 3 * step * DT + phase
        rate = np.pad(0.06 * np.cos(turn), ((0, 0), (0, 1)))
        td = turned_imu(Rotation.from_rotvec(np.pad(0.02 * np.sin(turn), ((0, 0), (0, 1)))), rate)
        td["measured", "base_angular_velocity"] = td["base_angular_velocity"] + bias
        if step == 0:
            got = [f._reset(TensorDict(batch_size=[4]), td.clone()) for f in filters]
        else:
            got = [f._call(td.clone()) for f in filters]
        for key in ("tilt", "gyro_bias"):
            one, other = (each["measured", key] for each in got)
            assert_close(one, other, atol=2e-3, rtol=0)
    assert (got[1]["measured", "gyro_bias"] > 0.2 * bias).all()


def test_up_follows_a_body_that_tumbles_about_any_axis():
    """Constant rates of the body, up to thirteen turns: SciPy's rotations, with gains of zero."""
    law, matrix = OnSphere(), torch.tensor([[1.0, 0.0], [-DT, 1.0], [DT, 0.0], [0.0, 0.0]])
    rate = 4.0 * np.random.default_rng(0).standard_normal((16, 3))
    begin = Rotation.random(16, random_state=0)
    state = law.begin(9.81 * turned_imu(begin, rate)["base_acceleration"])
    for _ in range(400):
        state = law.after(state, torch.tensor(rate).float(), torch.randn(16, 3), matrix)
    after = turned_imu(begin * Rotation.from_rotvec(400 * DT * rate), rate)
    assert_close(state[..., 0], -after["projected_gravity"], atol=1e-4, rtol=0)
    assert_close(law.tilt(state), roll_and_pitch(-after["projected_gravity"]), atol=1e-3, rtol=0)


@pytest.mark.parametrize(("cls", "good"), [(MahonyFilter, True), (TiltKalmanFilter, False)])
def test_a_robot_that_rolled_over_on_the_floor_knows_its_tilt_when_it_stands(make_base, cls, good):
    """Down on its belly in half a second, in four over its side and back, and up as fast."""
    base = make_base(num_envs=1, control_dt=DT)
    transform = cls(base)
    down, over = np.linspace(0, np.pi / 2, 26)[1:], np.linspace(0, 2 * np.pi, 201)[1:]
    pitch = np.concatenate([down, np.full(200, np.pi / 2), down[-2::-1], np.zeros(2)])
    turn = np.concatenate([np.zeros(25), over, np.zeros(26)])
    before = Rotation.identity(1)
    transform._reset(TensorDict(batch_size=[1]), turned_imu(before, np.zeros((1, 3))))
    for angle, around in zip(pitch, turn, strict=True):
        body = Rotation.from_rotvec([[0.0, angle, 0.0]]) * Rotation.from_rotvec([[0, 0, around]])
        rate = (before.inv() * body).as_rotvec() / DT
        transform.rate = torch.tensor(rate).float()[:, : transform.law.axes]  # as in between
        td, before = transform._call(turned_imu(body, rate)), body
    error = (td["measured", "tilt"] - td["tilt"]).abs().max()
    assert error < 0.01 if good else error > 0.3


@pytest.mark.parametrize("cls", [TiltKalmanFilter, MahonyFilter])
def test_filter_of_the_tilt_is_the_same_on_the_robot(make_base, cls):
    """From a robot that stands still, as it is switched on."""
    base = make_base(num_envs=1, control_dt=DT)
    transform = cls(base, also=["projected_gravity"])
    robot, generator = transform.on_robot(), np.random.default_rng(2)
    td = transform._reset(
        TensorDict(batch_size=[1]), turned_imu(Rotation.identity(1), np.zeros((1, 3)))
    )
    states, begin = dict(robot.states), True
    for _ in range(30):
        known = {**td, "begin": torch.tensor([[begin]])}
        known |= {("state", name): value for name, value in states.items()}
        robot.observe(known)
        for key in ("tilt", "gyro_bias", "projected_gravity"):
            assert_close(known["measured", key], td["measured", key], atol=1e-5, rtol=0)
        states, begin = {name: known["next", name] for name in states}, False
        body = Rotation.from_rotvec(2.0 * generator.standard_normal((1, 3)))
        td = transform._call(turned_imu(body, generator.standard_normal((1, 3))))


def joints(angle: torch.Tensor, velocity: torch.Tensor) -> TensorDict:
    return TensorDict({"joint_position": angle, "joint_velocity": velocity}, [len(angle)])


def test_velocity_of_all_joints_equals_filterpy_in_each(make_base):
    base = make_base(num_envs=2, control_dt=DT)
    transform = JointVelocityKalmanFilter(base)
    start, speed = torch.randn(2, 20), torch.randn(2, 20)
    td = transform._reset(TensorDict(batch_size=[2]), joints(start, speed))
    assert torch.equal(td["measured", "joint_velocity"], speed)
    kalman = JointVelocityKalmanFilter(base).kalman
    kalman.x = np.array([[start[1, 7].item()], [speed[1, 7].item()]])
    for _ in range(20):
        angle = torch.randn(2, 20)
        td = transform._call(joints(angle, speed))
        kalman.predict_steadystate()
        kalman.update_steadystate(np.array([[angle[1, 7].item()]]))
        got = td["measured", "joint_velocity"][1, 7].item()
        assert got == pytest.approx(kalman.x[1, 0], abs=1e-4)


def test_filtered_velocity_is_nearer_to_the_truth_than_the_difference(make_base):
    """A joint that swings by 0.3 rad at 4 rad/s, measured to 10 mrad."""
    base = make_base(num_envs=64, control_dt=DT)
    filters = {
        "kalman": JointVelocityKalmanFilter(base, position_std=0.01, acceleration_std=4.0),
        "difference": NumericalVelocity(base),
    }
    phase = 2 * math.pi * torch.rand(64, 20)
    square = dict.fromkeys(filters, 0.0)
    for step in range(150):
        turn = 4 * step * DT + phase
        td = joints(0.3 * torch.sin(turn), 1.2 * torch.cos(turn))
        td["measured", "joint_position"] = td["joint_position"] + 0.01 * torch.randn(64, 20)
        for name, transform in filters.items():
            if step == 0:
                got = transform._reset(TensorDict(batch_size=[64]), td.clone())
            else:
                got = transform._call(td.clone())
            error = got["measured", "joint_velocity"] - td["joint_velocity"]
            square[name] += error.square().mean().item()
    assert square["kalman"] < 0.15 * square["difference"]


def test_difference_is_exact_for_a_steady_motion(make_base):
    base = make_base(num_envs=2, control_dt=DT)
    transform = NumericalVelocity(base)
    speed = torch.randn(2, 20)
    td = transform._reset(TensorDict(batch_size=[2]), joints(torch.zeros(2, 20), speed))
    assert torch.equal(td["measured", "joint_velocity"], speed)
    for step in range(1, 4):
        td = transform._call(joints(step * DT * speed, speed))
        assert_close(td["measured", "joint_velocity"], speed, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    "cls", [TiltKalmanFilter, MahonyFilter, JointVelocityKalmanFilter, NumericalVelocity]
)
def test_partial_reset_equals_a_full_one_on_its_rows_and_none_on_the_others(make_base, cls):
    base = make_base(num_envs=2, control_dt=DT)

    def random():
        roll, rate = torch.randn(2, 2).unbind()
        return imu(roll, rate).update(joints(torch.randn(2, 20), torch.randn(2, 20)))

    course = [random() for _ in range(4)]
    key = ("measured", "tilt" if issubclass(cls, TiltKalmanFilter) else "joint_velocity")
    results = {}
    for name, rows in {"part": [True, False], "full": [True, True], "none": None}.items():
        transform = cls(base)
        transform._reset(TensorDict(batch_size=[2]), course[0].clone())
        transform._call(course[1].clone())
        if rows is not None:
            mask = TensorDict({"_reset": torch.tensor(rows)[:, None]}, [2])
            transform._reset(mask, course[2].clone())
        results[name] = transform._call(course[3].clone())[key]
    assert torch.equal(results["part"][0], results["full"][0])
    assert torch.equal(results["part"][1], results["none"][1])
    assert not torch.equal(results["full"], results["none"])


def test_estimates_can_be_named_in_a_vector_and_specs_hold(make_base):
    base = make_base()
    keys = ["tilt", "joint_velocity", ["measured", "gyro_bias"]]
    env = make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "noise": ObservationNoise(base, std={"joint_position": 0.01, "base_acceleration": 0.5}),
        "tilt": TiltKalmanFilter(base),
        "speed": JointVelocityKalmanFilter(base),
        "observation": ObservationVector(keys=keys, out_key="observation", measured=True),
        "critic": ObservationVector(keys=keys[:2], out_key="observation_critic", measured=False),
    })  # fmt: skip
    check_env_specs(env)
    td = env.rollout(5)["next"]
    parts = td["measured", "tilt"], td["measured", "joint_velocity"], td["measured", "gyro_bias"]
    assert torch.equal(td["observation"], torch.cat(parts, -1))
    assert torch.equal(td["observation_critic"], torch.cat([td["tilt"], td["joint_velocity"]], -1))


@pytest.mark.parametrize("cls", [JointVelocityKalmanFilter, NumericalVelocity])
def test_velocity_measured_twice_is_refused(make_base, cls):
    base = make_base()
    table = {
        "action": JointPositionTarget(base, scale=1.0),
        "noise": ObservationNoise(base, std={"joint_velocity": 0.01}),
        "speed": cls(base),
    }
    with pytest.raises(ValueError, match=rf"{cls.__name__} must stand before .*joint_velocity"):
        make_env(base, table)


@pytest.mark.parametrize(
    ("cls", "name"),
    [
        (TiltKalmanFilter, "gyro_std"),
        (TiltKalmanFilter, "bias_rate"),
        (TiltKalmanFilter, "angle_std"),
        (JointVelocityKalmanFilter, "position_std"),
        (JointVelocityKalmanFilter, "acceleration_std"),
    ],
)
def test_deviation_must_be_positive(make_base, cls, name):
    with pytest.raises(ValueError, match=rf"{name} must be positive, got 0.0"):
        cls(make_base(), **{name: 0.0})


def test_gravity_and_orientation_follow_from_the_estimate(make_task):
    """By SciPy's rotations, with the true heading."""
    also = ["projected_gravity", "base_orientation"]
    env = make_task(
        {
            "action": (JointPositionTarget, {"scale": 0.6}),
            "tilt": (TiltKalmanFilter, {"also": also}),
        },
        num_envs=8,
    )
    check_env_specs(env)
    torch.manual_seed(0)
    after = env.rollout(5)["next"][:, -1]
    true = Rotation.from_quat(after["base_orientation"].numpy()[:, [1, 2, 3, 0]])
    roll, pitch = after["measured", "tilt"].numpy().T
    heading = true.as_euler("ZYX")[:, 0]
    estimate = Rotation.from_euler("ZYX", np.stack([heading, pitch, roll], -1))
    got = Rotation.from_quat(after["measured", "base_orientation"].numpy()[:, [1, 2, 3, 0]])
    assert (got.inv() * estimate).magnitude().max() < 1e-5
    down = estimate.inv().apply([0.0, 0.0, -1.0])
    np.testing.assert_allclose(after["measured", "projected_gravity"], down, atol=1e-5)


def test_nothing_else_follows_from_a_tilt():
    node = {"_target_": "zfall.envs.transforms.estimation.TiltKalmanFilter", "also": ["target"]}
    with pytest.raises(ValueError, match="also must hold names of projected_gravity, base_orie"):
        check_nodes({"tilt": node})
