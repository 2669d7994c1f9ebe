"""The recipe of the reference motions: what it writes, and that the robot can walk them."""

import numpy as np
import pytest

from recipes import gaits
from recipes.gaits import servo_torque
from zfall.motions.library import GAITS, motions_file, walk
from zfall.robots import ZEROTH01


def test_the_recipe_writes_the_shipped_motions_and_a_table(tmp_path, monkeypatch, capsys):
    path = tmp_path / "motions.npz"
    monkeypatch.setattr(gaits, "motions_file", lambda robot: path)
    few = dict(list(GAITS.items())[:2])
    monkeypatch.setattr(gaits, "GAITS", few)
    gaits.main(seconds=0.04)
    with np.load(path) as written, np.load(motions_file(ZEROTH01)) as shipped:
        assert written.files == shipped.files
        rows = written["count"].sum()
        for key in ("joint_position", "base_linear_velocity"):
            np.testing.assert_allclose(written[key], shipped[key][:rows], atol=2e-6)
    table = capsys.readouterr().out
    assert all(name in table for name in few)


@pytest.mark.parametrize("name", ["forward_0.20", "backward_0.10", "turn_left_1.0"])
def test_torques_by_inverse_dynamics_walk_the_robot_at_the_speed_of_the_name(name):
    """Nothing keeps the balance: a motion that is not one of the physics ends on the floor."""
    gait = GAITS[name]
    walked = gaits.follow(gait, "torque", seconds=2.4, starts=3)
    assert walked.seconds.min().item() == pytest.approx(2.4)
    np.testing.assert_allclose(walked.speed, gait.speed, atol=0.012)
    np.testing.assert_allclose(walked.turn_rate, gait.turn_rate, atol=0.05)


@pytest.mark.parametrize("name", ["forward_0.20", "backward_0.10", "turn_right_1.0"])
def test_angles_alone_and_the_standing_pose_keep_the_robot_up_for_a_second(name):
    for kind in ("position", "velocity"):
        walked = gaits.follow(GAITS[name], kind, seconds=1.0, starts=3)
        assert walked.seconds.min().item() == pytest.approx(1.0)
    assert gaits.pose_hold(
        GAITS[name], seconds=1.0, starts=3
    ).seconds.min().item() == pytest.approx(1.0)


def test_weight_goes_evenly_from_foot_to_foot_in_double_support():
    """Of 30 ms about the touchdowns, every 0.3 s; the left foot is the first to stand."""
    time = np.array([0.015, 0.15, 0.285, 0.2925, 0.3, 0.315, 0.45, 0.6, 0.6075])
    left = [1, 1, 1, 0.75, 0.5, 0, 0, 0.5, 0.75]
    shares = gaits.weight_shares(GAITS["forward_0.10"], time)
    np.testing.assert_allclose(shares[:, 0], left, atol=1e-9)
    np.testing.assert_allclose(shares.sum(-1), 1)


@pytest.mark.parametrize("name", ["forward_0.15", "turn_left_0.5"])
def test_work_of_the_servos_over_a_stride_is_what_the_gears_lose(name):
    """A stride ends with the energy it began with; soles at rest do no work."""
    gait = GAITS[name]
    begin, end = gait.stride
    time = np.linspace(begin, end, 601)
    speed = walk(ZEROTH01, gait, time)["joint_velocity"]
    work = np.trapezoid((servo_torque(ZEROTH01, gait, time) * speed).sum(-1), time)
    damping, friction = 1.3464, 0.2  # of the leg servos [N m s/rad, N m]; the arms are at rest
    loss = np.trapezoid((damping * speed**2 + friction * np.abs(speed)).sum(-1), time)
    assert work == pytest.approx(loss, rel=0.02)
