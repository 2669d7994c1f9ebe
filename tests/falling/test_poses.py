"""Poses in which the robot rests on its knees."""

import numpy as np
import pytest

from zfall.falling.kneels import kneels_of
from zfall.falling.poses import draw, search_poses, settle
from zfall.robots import ZEROTH01
from zfall.rotations import tilt

JOINTS = ZEROTH01.joints


@pytest.mark.parametrize("kind", kneels_of(ZEROTH01).searches)
def test_drawn_poses_lie_within_the_joint_ranges_and_their_own(make_base, kind):
    angles, lean = draw(ZEROTH01, kind, 200, np.random.default_rng(0))
    low, high = make_base(num_envs=1).joint_range.numpy().T
    assert ((angles >= low - 1e-6) & (angles <= high + 1e-6)).all()
    knees = [angles[:, JOINTS.index(f"{side}_knee_pitch")] for side in ("left", "right")]
    assert (knees[0] == knees[1]).all() == (kind == "both knees")
    assert lean.min() < -0.3
    assert lean.max() > 0.4


def test_a_pose_is_put_on_the_floor_before_the_servos_hold_it(make_base):
    """The standing pose begins where it rests: after a moment it has neither fallen nor bounced."""
    td = settle(make_base(num_envs=1), np.array([ZEROTH01.stand_position]), np.zeros(1), 0.4)
    assert td["feet_contact"].all()
    assert td["base_linear_velocity"].norm() < 0.02
    assert tilt(td["base_orientation"]).item() < 0.02


def test_the_search_keeps_what_rests(make_base, monkeypatch):
    """Of 32 half-kneels drawn near the robot's own some rest; both legs and hands are checked."""
    kneel = dict(zip(JOINTS, ZEROTH01.posture("kneel"), strict=True))

    def near(robot, kind, count, generator):
        angles = np.tile(np.array(robot.posture("kneel")), (count, 1))
        return angles + generator.normal(0.0, 0.05, angles.shape), np.full(count, 0.06)

    monkeypatch.setattr("zfall.falling.poses.draw", near)
    copies = make_base(num_envs=4)
    found = search_poses(make_base(num_envs=32), copies, "half-kneel", 1, np.random.default_rng(1))
    assert len(found) > 3
    for pose in found:
        assert pose.leaning < 0.6
        assert pose.com_height == pytest.approx(0.14, abs=0.03)
        assert 0.0 <= pose.robust <= 1.0
        assert pose.angles[JOINTS.index("left_hip_pitch")] == pytest.approx(
            kneel["left_hip_pitch"], abs=0.3
        )
    rank = [-pose.robust + pose.torque + pose.leaning for pose in found]
    assert rank == sorted(rank)
