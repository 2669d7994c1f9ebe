"""The trials that a trigger learns from."""

import pytest
import torch

from zfall.envs.tables import keep
from zfall.falling.fall_network import SHIPPED
from zfall.falling.trigger import History, labels, record, split, without_trigger
from zfall.policies import load_policy

FEW = {"measured": SHIPPED["keys"], "starts": 1}


@pytest.mark.long
def test_what_is_recorded_is_what_happened():
    """Pushes begin at any time of three seconds, and fell everybody within 0.6 s.

    So nothing but the push itself tells that a fall is coming.
    """
    policy = load_policy("best")
    env_cfg, actor = policy.config.env, policy.actor
    history, control_dt = record(env_cfg, actor, impulses=[1.5], **FEW)
    assert control_dt == 0.04
    steps = history.live.shape[1]
    assert steps == round(6.0 / 0.04)
    before = (~history.pushed).sum(1).numpy()  # steps that end before the push begins
    begin = 0.04 * before
    assert 0.46 <= begin.min() < 0.9 < 3.1 < begin.max() <= 3.5
    assert begin[24:].std() == pytest.approx(3.0 / 12**0.5, rel=0.35)
    assert int(history.fell.sum()) == 24  # the control arm stands
    assert not history.fell[:24].any()
    lived = 0.04 * history.live[24:].sum(1).numpy()
    assert ((lived - begin[24:] > 0.15) & (lived - begin[24:] < 0.6)).all()
    upright = torch.arange(steps) < torch.from_numpy(before)[:, None]
    assert history.lean[upright].max() < 0.2 < history.lean[24:].amax(1).min()
    noisy, _ = record(keep(env_cfg, ["noise"]), actor, impulses=[1.5], **FEW)
    spread = (noisy.measured - history.measured)[:, :1, :3].std()  # of gravity, in the first step
    assert spread == pytest.approx(0.01, rel=0.3)  # as the task says


@pytest.mark.long
def test_a_policy_with_modes_is_recorded_while_it_recovers():
    """Its own rule gives up after pushes that it withstands, which is no fall to learn from."""
    changes = ["transforms.mode.probability=null", "transforms.mode.angular_velocity=0.5"]
    kneel, best = load_policy("kneel", changes=changes), load_policy("best")
    env_cfg = kneel.config.env
    gives_up, _ = record(env_cfg, kneel.actor, impulses=[0.2], **FEW)
    recovers, _ = record(without_trigger(env_cfg), kneel.actor, impulses=[0.2], **FEW)
    assert gives_up.fell.sum() > 12
    assert recovers.fell.sum() == 0
    alone, _ = record(best.config.env, best.actor, impulses=[0.2], **FEW)
    torch.testing.assert_close(recovers.lean, alone.lean, rtol=0, atol=1e-4)


def made_up(fell: list[bool], steps: int = 4) -> History:
    """Trials whose push begins in the third step."""
    count = len(fell)
    zero = torch.zeros(count, steps)
    pushed = (torch.arange(steps) >= 2).expand(count, -1)
    live = torch.ones(count, steps, dtype=torch.bool)
    number = torch.arange(float(count))[:, None, None].expand(-1, steps, 1)
    return History(number, zero, zero, live, torch.tensor(fell), pushed)


def test_before_the_push_no_fall_is_sure():
    truth = labels(made_up([True, False]))
    assert truth.tolist() == [[0.0, 0.0, 1.0, 1.0], [0.0] * 4]


def test_trials_go_to_three_parts_in_the_order_given():
    parts = split(made_up([True, False] * 10), torch.arange(19, -1, -1))
    numbers = [part.measured[:, 0, 0].tolist() for part in parts]
    assert [len(part) for part in numbers] == [12, 4, 4]
    assert [number for part in numbers for number in part] == list(range(19, -1, -1))


def test_a_part_without_falls_is_refused():
    with pytest.raises(ValueError, match="impulses and starts .* of 4 0 fell"):
        split(made_up([True, False] * 6 + [False] * 8), torch.arange(20))
