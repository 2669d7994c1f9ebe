"""States in the midst of falls: what is recorded, and that falls go on from there."""

import io

import pytest
import torch
from hydra.utils import instantiate
from rich.console import Console
from torch.testing import assert_close
from torchrl.envs.utils import ExplorationType, set_exploration_type

from zfall.envs.humanoid import STATE_KEYS
from zfall.evaluation.battery import run_battery
from zfall.evaluation.definitions import load_battery
from zfall.falling.banks import ESTIMATES, PUSH_KEYS, SEEN_KEYS, load_bank, save_bank
from zfall.falling.modes import RECOVER
from zfall.falling.recording import record_falls
from zfall.policies import load_policy
from zfall.robots import ZEROTH01
from zfall.rotations import rotate_inverse

HARD = {"points": ["torso"], "impulses": [1.5], "starts": 1}  # 24 directions


def test_what_is_recorded_is_read_back_from_a_bank(tmp_path):
    policy = load_policy("best")
    recording = record_falls(policy.config.env, policy.actor, times=[0.12], **HARD)
    assert recording.trials == 24
    assert recording.fell == len(recording.states["joint_position"]) == 24
    save_bank(tmp_path / "falls.npz", recording.states)
    bank = load_bank(tmp_path / "falls.npz", ZEROTH01, needs=(*PUSH_KEYS, *SEEN_KEYS))
    for key, value in recording.states.items():
        assert torch.equal(bank[key], value.flatten(1))


def test_in_the_twin_what_its_estimators_made_of_the_fall_is_recorded_too(tmp_path):
    """0.12 s after I = 1.5 the trunk turns by radians per second, which they are late to see."""
    policy = load_policy("twin_25hz")
    recording = record_falls(policy.config.env, policy.actor, times=[0.12], world="twin", **HARD)
    save_bank(tmp_path / "falls.npz", recording.states)
    bank = load_bank(tmp_path / "falls.npz", ZEROTH01, needs=tuple(ESTIMATES))
    up = -bank["measured_gravity"]
    assert_close(up.norm(dim=-1), torch.ones(len(up)))
    true = rotate_inverse(bank["base_orientation"], torch.tensor([[0.0, 0.0, 1.0]]))
    off = torch.acos((up * true).sum(-1).clamp(-1, 1))
    assert 0.02 < off.median() < 0.3
    leans = torch.acos(torch.stack([up[:, 2], true[:, 2]]).clamp(-1, 1))
    assert (leans[0] < leans[1]).float().mean() > 0.7


def test_a_policy_that_never_gives_up_has_no_trigger():
    policy = load_policy("best")
    with pytest.raises(ValueError, match="times .* without modes"):
        record_falls(policy.config.env, policy.actor, times=None, **HARD)


def test_times_after_the_end_give_nothing_to_record():
    policy = load_policy("best")
    shown = Console(file=io.StringIO(), force_terminal=True)
    with pytest.raises(ValueError, match="times must give a state"):
        record_falls(policy.config.env, policy.actor, times=[9.0], console=shown, **HARD)
    assert "pushed trials" in shown.file.getvalue()  # the bar


@pytest.mark.long
def test_a_fall_goes_on_from_a_bank_as_in_the_trial_it_was_taken_from(tmp_path):
    """What the policy sees first decides what it does: the target, the feet, the speed."""
    policy = load_policy("kneel_soft")
    cfg, actor = policy.config.env, policy.actor
    battery = load_battery("kneel", impulses=[1.25], forces=[], starts=1)  # twelve directions
    keys, history = (*STATE_KEYS, *SEEN_KEYS, "mode"), []
    trials = run_battery(
        battery, cfg, actor, watch=lambda _, td: history.append(td.select(*keys).clone())
    )
    over = torch.stack(history, 1)[: len(trials)][12:]  # behind twelve without a push
    step = (over["mode"][..., RECOVER] == 0).float().argmax(1)  # at which each was given up
    assert (step > 10).all()
    each = torch.arange(12)
    begin, later = over[each, step], over[each, step + 6]
    pushes = trials.iloc[12:]
    heading = torch.tensor(pushes["direction_rad"].to_numpy(copy=True))
    force = torch.tensor(pushes["force_n"].to_numpy(copy=True))
    since = (step + 1) * 0.04 - battery.push_time
    bank = {key: begin[key].flatten(1) for key in (*STATE_KEYS, *SEEN_KEYS)}
    bank["push_force"] = torch.stack([heading.cos(), heading.sin(), 0 * heading], -1)
    bank["push_force"] *= force[:, None]
    bank["push_left"] = (0.1 - since).clamp_min(0.0)[:, None]
    save_bank(tmp_path / "falls.npz", bank)
    cfg.transforms.falling = {
        "_target_": "zfall.falling.falling_start.FallingStart",
        "bank": str(tmp_path / "falls.npz"),
        "pushed": True,
        "before": "action",
    }
    cfg.transforms.mode.initial = "kneel"
    cfg.base_env.num_envs = 64
    env = instantiate(cfg, training=False)
    env.set_seed(0)
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        td = env.reset()
        of = torch.cdist(td["joint_velocity"], begin["joint_velocity"]).argmin(1)
        assert len(of.unique()) == 12
        for _ in range(6):
            td = env.step(actor(td))["next"]
    for key in ("joint_position", "base_orientation", "com_velocity"):
        assert_close(td[key], later[key][of], atol=1e-4, rtol=0)
