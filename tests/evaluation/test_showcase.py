"""What is filmed at the end of a training."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from zfall.evaluation.battery import battery_env, play
from zfall.evaluation.candidate import load_candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.showcase import SIDES, record


@pytest.mark.parametrize("push_time", [3.0, 2.0])
def test_film_shows_one_push_from_each_side_when_that_of_the_battery_comes(
    compose_config, push_time
):
    """0.6 s into the film, for 0.1 s, of I = 0.4, where I = 1 is 49 N; frames are 0.04 s apart."""
    battery = replace(load_battery("planar"), push_time=push_time)
    recorded = record(battery, compose_config().env, None)
    qpos, forces = recorded.states, recorded.pushed.force
    assert len(qpos) == len(forces) == 90  # 3.6 s
    away = {"from behind": (1, 0), "from the right": (0, 1), "from the front": (-1, 0), "from the left": (0, -1)}  # fmt: skip
    for index, side in enumerate(SIDES):
        pushed = np.flatnonzero(np.abs(forces[:, index]).sum(1) > 0.1)
        assert 0.6 <= 0.04 * pushed[0] <= 0.64
        assert 1 <= len(pushed) <= 3
        expected = 0.4 * 49 * np.array([*away[side], 0])
        assert forces[pushed[0], index] == pytest.approx(expected, abs=0.3)
    moved = np.linalg.norm(qpos[:, :, :2] - qpos[:1, :, :2], axis=-1)  # of the base [m]
    assert moved[: pushed[0] - 1].max() < 0.005  # it stands still until then
    assert moved[-1, [0, 2]].min() > 0.1  # and falls forward and backward
    said = [outcome[0][1] for outcome in recorded.outcomes]
    assert [text.startswith("fell ") for text in said] == [True, False, True, False]


def test_a_policy_with_a_memory_is_filmed_and_stands_where_servos_fall():
    """Pushed by I = 0.4 from four sides in the nominal world."""
    policy = load_candidate("twin")
    recorded = record(replace(load_battery("planar"), push_time=1.0), policy.env_cfg, policy.actor)
    assert [outcome[0][1] for outcome in recorded.outcomes] == ["stays up"] * 4


def test_what_is_played_carries_the_memory_from_step_to_step():
    """As torch's GRU has it after all that it saw, as one sequence; played again, it begins anew."""
    policy = load_candidate("twin")
    env, _, _ = battery_env(load_battery("planar"), policy.env_cfg, 64)
    cell = next(module for module in policy.actor.modules() if isinstance(module, torch.nn.GRU))
    for _ in range(2):
        saw: list[torch.Tensor] = []
        hook = cell.register_forward_hook(lambda cell, given, out, saw=saw: saw.append(given[0]))
        *_, last = play(env, policy.actor, 5)
        hook.remove()
        with torch.no_grad():
            expected = cell(torch.cat(saw, 1))[1].transpose(0, 1)
        assert len(saw) == 5
        assert expected.abs().max() > 0.1
        torch.testing.assert_close(last["recurrent_state_actor"], expected, atol=1e-5, rtol=0.0)
