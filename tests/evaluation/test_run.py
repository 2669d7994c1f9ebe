"""Batteries from Python."""

import pandas as pd
import pytest

import zfall
from zfall.evaluation import evaluate, load_battery
from zfall.evaluation.candidate import load_candidate, load_candidates
from zfall.evaluation.run import setting_name

SMALL = {"starts": 1, "directions": 2, "impulses": [0.2, 1.9], "end_time": 5.0}


def test_evaluate_gives_trials_and_their_summary():
    """Two directions x two sizes, and one trial of each direction without a push."""
    result = evaluate("best", "planar", num_envs=64, **SMALL)
    assert len(result.trials) == result.summary["n"] == 2 * 2 + 2
    rates = result.trials.groupby("impulse")["recovered"].mean()
    assert result.summary["success"] == {"0.2": rates[0.2], "1.9": rates[1.9]}
    assert result.summary["i50_mean"] == pytest.approx(0.2)
    assert result.summary["definition"]["starts"] == 1
    again = evaluate(zfall.load_policy("best"), load_battery("planar", **SMALL), num_envs=128)
    pd.testing.assert_frame_equal(again.trials, result.trials)
    other = evaluate("best", "planar", seed=1, num_envs=64, **SMALL)
    assert not other.trials["peak_tilt"].equals(result.trials["peak_tilt"])


def test_evaluate_takes_baselines_in_any_world():
    small = SMALL | {"impulses": [1.9], "directions": 1}
    still = evaluate("pose_hold", env="zeroth_fall", num_envs=64, **small)
    assert still.trials["fell"].tolist() == [False, True]
    limp = evaluate("limp", num_envs=64, **small)
    assert limp.trials["fell"].tolist() == [True, True]


def test_an_envelope_is_bisected_from_python():
    small = {"point": "torso", "directions": 1, "starts": 1, "impulses": [0.8], "resolution": 0.4}
    result = evaluate("pose_hold", "envelope", num_envs=64, end_time=4.5, **small)
    assert result.trials["round"].tolist() == [0, 1, 2]
    assert result.trials["impulse"].tolist() == [0.0, 0.8, 0.4]
    assert set(result.summary["largest_mean"]) == {"torso"}


@pytest.mark.parametrize(
    ("policy", "battery", "given", "message"),
    [
        ("nobody", "planar", {}, "run .*nobody"),
        ("best", "linear", {}, "battery .*got 'linear'"),
        ("best", "planar", {"pont": 1}, r"battery\.pont is not a key .*did you mean point"),
        ("best", "planar", {"keep": ["push"]}, "keep .*push"),
        ("best", "planar", {"env": "zeroth_fall"}, "env .*best"),
        ("best", "planar", {"change": ["transforms.action.skale=1"]}, "change .*skale"),
        ("best", "planar", {"memory": False}, "memory must be true for best, which has none"),
        ("limp", "planar", {"memory": False}, "memory must be true for limp, which has none"),
    ],
)
def test_what_cannot_be_evaluated_is_refused(policy, battery, given, message):
    with pytest.raises(ValueError, match=message):
        evaluate(policy, battery, **given)


def test_a_policy_may_be_made_to_forget():
    """best_gru acts otherwise then, and what is known of it is kept apart."""
    small = {"starts": 1, "directions": 1, "impulses": [0.3], "end_time": 3.5}
    policy = zfall.load_policy("best_gru")
    own, without = (evaluate(policy, num_envs=64, memory=memory, **small) for memory in (1, 0))
    assert not own.trials["peak_tilt"].equals(without.trials["peak_tilt"])
    battery = load_battery("planar", **small)
    (candidate,) = load_candidates([policy], memory=False)
    assert candidate.conditions(battery, seed=0)["memory"] is False
    assert "memory" not in load_candidate(policy).conditions(battery, seed=0)
    assert candidate.still().memory


def test_options_belong_to_the_battery():
    with pytest.raises(ValueError, match="options .*starts"):
        evaluate("best", load_battery("planar"), starts=1)


def test_a_setting_is_named_by_what_differs_and_never_too_long():
    given = {"point": "pelvis", "impulses": [0.1, 0.2], "seed": 3}
    assert setting_name("planar", given) == "planar_point-pelvis_impulses-0.1,0.2_seed-3"
    assert setting_name("planar", {}) == "planar"
    assert setting_name("planar", {"aftermath": None}) == "planar_aftermath-None"
    many, more = ({"impulses": [0.1] * n} for n in (50, 51))
    long = setting_name("planar", many)
    assert len(long) < 20
    assert long != setting_name("planar", more)
    assert "/" not in setting_name("planar", {"change": ["a=b/c"]})
