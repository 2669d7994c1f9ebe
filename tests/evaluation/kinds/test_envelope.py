"""Bisection on made-up policies, and a block whose tipping impulse is known."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
from omegaconf import OmegaConf

from tests.block import HALF_HEIGHT, HALF_WIDTH, MASS, block_robot, inertia
from zfall.evaluation.candidate import Candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.kinds.envelope import Envelope, envelope_table
from zfall.evaluation.plans import plan_trials
from zfall.evaluation.run import trials_of
from zfall.robots import GRAVITY, PushPoint, Robot


def test_bisection_finds_thresholds_that_differ_from_cell_to_cell():
    """Three of five starts withstand a little more than the threshold, two a little less."""
    battery = load_battery("envelope", point=["torso", "pelvis"], directions=8)

    def threshold(plan: pd.DataFrame) -> pd.Series:
        at_pelvis = plan["body"] == "pelvis"
        return 0.3 + 0.1 * plan["direction_rad"] + 0.25 * at_pelvis

    def run(plan: pd.DataFrame) -> pd.DataFrame:
        start = plan["trial"] % 5
        own = threshold(plan) * np.where(start < 3, 1.001, 0.8)
        return plan.assign(recovered=plan["impulse"] < own)

    trials = Envelope().run(battery, plan_trials(battery, 1.0, seed=0), run)
    table = envelope_table(trials)
    assert len(table) == 16
    assert (table["largest"] <= threshold(table) * 1.001).all()
    assert (table["smallest_failed"] >= threshold(table)).all()
    assert (table["smallest_failed"] - table["largest"] <= 0.02 + 1e-9).all()
    assert (trials["round"] == 0).sum() == 8 * 5  # the control arm
    repeats = trials[trials["round"] > 0].groupby("trial")["body"].nunique()
    assert (repeats == 1).all()  # the same starts in every round


def test_a_policy_that_never_falls_has_no_smallest_that_failed():
    battery = load_battery("envelope", point="torso", directions=2)
    plan = plan_trials(battery, 1.0, seed=0)
    found = {}
    for recovered in (True, False):
        trials = Envelope().run(battery, plan, lambda plan: plan.assign(recovered=recovered))  # noqa: B023
        found[recovered] = envelope_table(trials)
    assert (found[True]["largest"] == 2.0).all()
    assert found[True]["smallest_failed"].isna().all()
    assert (found[False]["largest"] == 0.0).all()
    assert (found[False]["smallest_failed"] <= 0.02).all()


def pushed_block(folder: str, offset: float) -> Robot:
    """The block with a push point so far above its center of mass."""
    robot = block_robot(Path(folder))
    robot.push_points["percussion"] = PushPoint(body="block", offset=(0.0, 0.0, offset))
    return robot


def test_a_block_tips_at_the_impulse_of_rigid_body_mechanics(tmp_path):
    """Pushed at its center of percussion above the edge, so that the edge feels no shear.

    ``J z = I w`` about the edge, and ``I w^2 / 2 = m g (r - h)`` to bring the center above it.
    """
    about_edge = inertia()[0] + MASS * (HALF_WIDTH**2 + HALF_HEIGHT**2)
    height = about_edge / (MASS * HALF_HEIGHT)
    rise = math.hypot(HALF_WIDTH, HALF_HEIGHT) - HALF_HEIGHT
    spin = math.sqrt(2 * MASS * GRAVITY * rise / about_edge)
    impulse = about_edge * spin / height / (MASS * math.sqrt(GRAVITY * HALF_HEIGHT))
    cfg = OmegaConf.create(
        {
            "base_env": {
                "_target_": "zfall.envs.humanoid.HumanoidEnv",
                "control_dt": 0.01,
                "physics_dt": 0.001,
                "robot": {
                    "_target_": "tests.evaluation.kinds.test_envelope.pushed_block",
                    "folder": str(tmp_path),
                    "offset": height - HALF_HEIGHT,
                },
            },
            "transforms": {
                "action": {
                    "_target_": "zfall.envs.transforms.actions.JointPositionTarget",
                    "scale": 1.0,
                }
            },
        }
    )
    battery = load_battery(
        "envelope", point="percussion", directions=4, impulses=[0.4], starts=1, duration=0.004,
        resolution=0.003, start_noise=0.0, push_time=0.1, end_time=1.4,
    )  # fmt: skip
    trials = trials_of(battery, Candidate("pose_hold", cfg, None), num_envs=64)
    np.testing.assert_allclose(envelope_table(trials)["largest"], impulse, rtol=0.03)
