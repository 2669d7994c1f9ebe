"""The recorded midst of falls, from the shell."""

import re

import numpy as np
import pytest

from tests.shell import run
from zfall.robots import ZEROTH01

FORCE = 1.5 * ZEROTH01.impulse_unit / 0.1  # [N]
HARD = ["points=[torso]", "impulses=[1.5]", "starts=1"]  # 24 directions


def test_states_at_given_times_and_what_is_left_of_the_push(tmp_path):
    """Pushes of 0.1 s begin in any physics step: 0.06 to 0.096 s before the first state.

    Nothing is left at the second; nobody withstands it. Who was pushed for longer is faster.
    """
    done = run(
        "falling.falls", "run=pose_hold", *HARD, "times=[0.08,0.12]", f"hydra.run.dir={tmp_path}"
    )
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "falls.npz") as falls:
        left, force = falls["push_left"][:, 0], np.linalg.norm(falls["push_force"], axis=1)
        speed = np.linalg.norm(falls["base_linear_velocity"][:, :2], axis=1)
    assert len(left) == 48
    steps, first = left / 0.004, left > 0.001
    assert steps == pytest.approx(steps.round(), abs=1e-4)
    assert int(first.sum()) == 24
    assert set(steps[first].round()) <= set(range(1, 11))
    assert len(set(steps[first].round())) >= 6
    assert np.corrcoef(speed[first], 0.1 - left[first])[0, 1] > 0.5
    assert force[first] == pytest.approx(FORCE, rel=1e-5)
    assert (force[~first] == 0.0).all()


def test_a_limp_robot_falls_otherwise_than_one_that_holds_its_pose(tmp_path):
    bent = {}
    for name in ("limp", "pose_hold"):
        own = [*HARD, "times=[0.08]", f"hydra.run.dir={tmp_path}/{name}"]
        assert run("falling.falls", f"run={name}", *own).returncode == 0
        with np.load(tmp_path / name / "falls.npz") as falls:
            bent[name] = np.abs(falls["joint_position"] - ZEROTH01.stand_position).max(axis=1)
    assert bent["limp"].mean() > 2 * bent["pose_hold"].mean()


def test_states_at_the_trigger_of_a_policy_that_kneels(tmp_path):
    """Once for each push, while it goes on or after it."""
    done = run("falling.falls", "run=kneel", *HARD, "times=null", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    with np.load(tmp_path / "falls.npz") as falls:
        left, position = falls["push_left"][:, 0], falls["base_position"]
        target, force = falls["target"], falls["feet_force"]
        sideways = np.sum(falls["com_velocity"][:, :2] * falls["push_force"][:, :2], axis=1)
    assert target.shape[1:] == (20,)
    assert (np.abs(target - ZEROTH01.stand_position).max(axis=1) > 0.1).mean() > 0.5  # it stepped
    assert force.shape[1:] == (6,)
    assert (force[:, [2, 5]].sum(axis=1) > 1.0).mean() > 0.5  # still on its feet
    assert (sideways[left > 0.01] > 0.0).mean() > 0.9
    assert 20 <= len(left) <= 24
    assert (left > 0.01).sum() >= 12  # it gives up before such a push is over
    assert len({round(float(time), 3) for time in left}) >= 6  # not all begin with a control step
    assert (position[:, :2] == 0.0).all()


def test_a_policy_without_modes_has_no_trigger(tmp_path):
    done = run("falling.falls", "run=pose_hold", *HARD, "times=null", f"hydra.run.dir={tmp_path}")
    assert done.returncode != 0
    assert re.match("error: times .* without modes", done.stderr)
