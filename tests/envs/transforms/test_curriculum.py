"""Levels count successes; fields follow levels."""

import math

import pytest
import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget
from zfall.envs.transforms.curriculum import Curriculum
from zfall.envs.transforms.observations import ObservationNoise
from zfall.envs.transforms.pushes import RandomPush
from zfall.envs.transforms.terminations import time_limit
from zfall.falling.modes import ModeMachine

TABLE = {
    "action": (JointPositionTarget, {"scale": 1.0}),
    "push": (
        RandomPush,
        {"point": "torso", "size": [0.1, 0.2], "duration": 0.1, "interval": [0.5, 1]},
    ),
    "noise": (ObservationNoise, {"std": {"joint_position": 0.01}}),
    "delay": (ActuatorDelay, {"delay": [0.0, 0.004]}),
    "mode": (ModeMachine, {}),
    "limit": (time_limit, {"seconds": 100.0}),
}


def course(make_task, fields: dict, **values):
    return make_task({**TABLE, "curriculum": (Curriculum, {"fields": fields} | values)})


def ended(transform: Curriculum, terminated: list[bool], done: list[bool]) -> None:
    """Tells the curriculum how the worlds' steps ended."""
    flags = {"terminated": terminated, "done": done}
    td = TensorDict({key: torch.tensor(value)[:, None] for key, value in flags.items()})
    transform._step(td, td)


def find(env, kind):
    return next(t for t in env.transform if isinstance(t, kind))


def test_success_raises_and_a_fall_lowers_only_the_level_of_its_world(make_task):
    env = course(make_task, {"noise.std.joint_position": [0.0, 0.1]}, up=0.1, down=0.05, level=0.5)
    curriculum, noise = find(env, Curriculum), find(env, ObservationNoise)
    ended(curriculum, [False, True, False, True], [True, True, False, False])
    assert_close(curriculum.level, torch.tensor([0.6, 0.45, 0.5, 0.5]))
    assert_close(noise.std["joint_position"], torch.tensor([0.06, 0.045, 0.05, 0.05]))


def test_an_aim_reached_raises_the_level_and_any_other_end_lowers_it(make_task, compose_config):
    """Reached it, fell, ran out of time, goes on."""
    env = course(make_task, {"push.size": [[0.1, 0.2], [0.5, 0.9]]}, up=0.1, down=0.05, level=0.5)
    curriculum = find(env, Curriculum)
    curriculum.success = "there"
    td = TensorDict(
        {
            "done": torch.tensor([[True], [True], [True], [False]]),
            "terminated": torch.tensor([[True], [True], [False], [False]]),
            "terminations": {"there": torch.tensor([[True], [False], [False], [False]])},
        }
    )
    curriculum._step(td, td)
    assert_close(curriculum.level, torch.tensor([0.6, 0.45, 0.45, 0.5]))
    cfg = compose_config(
        "num_envs=2", "experiment=push_to_kneel_kneel", "env.transforms.curriculum.success=there"
    )
    with pytest.raises(InstantiationException, match=r"success must name .*stable.*got there"):
        instantiate(cfg.env)


def test_levels_stay_within_their_bounds(make_task):
    env = course(make_task, {"push.size": [[0.1, 0.2], [0.5, 0.9]]}, up=0.7, down=0.7)
    curriculum = find(env, Curriculum)
    for _ in range(3):
        ended(curriculum, [False, True, False, True], [True] * 4)
    assert curriculum.level.tolist() == [1.0, 0.0, 1.0, 0.0]


def test_pairs_are_interpolated_between_stages_or_kept_until_the_next(make_task):
    stages = {"push.size": [[0.0, 0.2], [0.2, 0.4], [0.8, 1.0]]}
    for stepwise, expected in ((False, [0.5, 0.7]), (True, [0.2, 0.4])):
        env = course(make_task, stages, level=0.75, stepwise=stepwise)
        size = find(env, RandomPush).size
        assert_close(size[:, 0], torch.tensor(expected))


def test_pushes_of_a_world_have_the_size_of_its_level(make_task):
    env = course(make_task, {"push.size": [[0.1, 0.1], [0.5, 0.5]]})
    curriculum = find(env, Curriculum)
    curriculum.level = torch.tensor([0.0, 0.25, 0.5, 1.0])
    curriculum._move()
    td, sizes = env.reset(), []
    for _ in range(60):
        td["action"] = torch.zeros(4, 20)
        td = env.step(td)["next"]
        sizes.append(td["push", "size"][:, 0])
    for world, expected in enumerate([0.1, 0.2, 0.3, 0.5]):
        size = torch.stack(sizes)[:, world]
        pushed = size > 0
        assert (pushed[1:] & ~pushed[:-1]).sum() >= 2  # the second is as large as the first
        assert_close(size[pushed], torch.full_like(size[pushed], expected))


def test_delays_of_a_world_are_those_of_its_level(make_task):
    """0 at level 0, 20 ms at level 1, 8 ms between them: the command of so many steps ago."""
    env = course(make_task, {"delay.delay": [[0.0, 0.0], [0.02, 0.02]]})
    curriculum, base = find(env, Curriculum), env.base_env
    curriculum.level = torch.tensor([0.0, 0.4, 1.0, 1.0])
    curriculum._move()
    seen, step = [], base._step
    base._step = lambda td: seen.append(td["control"].clone()) or step(td)
    td = env.reset()
    for action in (0.0, 0.1):
        td["action"] = torch.full((4, 20), action)
        td = env.step(td)["next"]
    changed = (seen[1] - seen[0]).abs().amax(-1) > 0.05  # (4, 10)
    assert (~changed).sum(1).tolist() == [0, 2, 5, 5]


def test_a_restored_level_moves_the_fields(make_task):
    fields = {"push.size": [[0.1, 0.1], [0.5, 0.5]]}
    env, other = course(make_task, fields), course(make_task, fields)
    find(env, Curriculum).level.fill_(0.5)
    other.transform.load_state_dict(env.transform.state_dict())
    assert_close(find(other, RandomPush).size, torch.full((2, 4), 0.3))


@pytest.mark.parametrize(("fields", "message"), [
    ({"kick.size": [0, 1]}, "fields.kick.size must begin with a transform of the table, one of action, push"),
    ({"push.strength": [0, 1]}, "fields.push.strength: there is no 'strength', only .*size"),
    ({"push.axes.x": [0, 1]}, "fields.push.axes.x: there is no 'x', only null"),
    ({"push.size": [0.1, 0.2]}, r"fields.push.size must hold values like \[0.1, 0.2\], got"),
    ({"push.force": [1, 2]}, "fields.push.force must be a number or a pair, it is None"),
    ({"push.direction": [0, 1]}, "must be a number or a pair, it is 'planar'"),
    ({"push.size": [[0.1, 0.2]]}, "fields.push.size must hold at least two stages"),
    ({"push.size": [[0.1, 0.2], [-0.3, 0.4]]}, r"push.size must be finite and within \[0, inf\] at every"),
    ({"push.size": [[0.1, 0.2, 0.3], [0.1, 0.2, 0.3]]}, r"push.size must hold values like \[0.1, 0.2\]"),
    ({"push.size": [[0.1, 0.2], [0.1]]}, "push.size must hold numbers or pairs alone"),
    ({"push.size": 0.3}, "push.size must hold at least two stages, got 0.3"),
    ({"push.duration": [[0, 0], [0.1, 0.1]]}, r"push.duration must be finite and within \[1e-06, inf\]"),
    ({"noise.std.joint_position": [0.0, -0.1]}, r"must be finite and within \[0, inf\]"),
    ({"noise.std.joint_position": [0.0, math.nan]}, r"must be finite and within \[0, inf\]"),
    ({"delay.delay": [[0, 0], [0.2, 0.2]]}, r"delay.delay must be finite and within \[0, 0.1\]"),
    ({"limit.max_steps": [10, 20]}, "fields.limit.max_steps must stay: it counts steps"),
    ({"mode.rule.hold": [1, 5]}, "fields.mode.rule.hold must stay: it counts steps"),
])  # fmt: skip
def test_bad_fields_are_refused(make_task, fields, message):
    with pytest.raises(ValueError, match=message):
        course(make_task, fields)


def test_times_of_pushes_that_follow_from_their_duration_keep_it(make_task):
    push = {"point": "torso", "size": [0.1, 0.2], "duration": 0.1, "times": [0.0, 0.15]}
    fields = {
        "push.duration": [[0.1, 0.1], [0.4, 0.4]]
    }  # of which the second would begin too early
    with pytest.raises(ValueError, match=r"fields.push.duration must stay: the times"):
        make_task(
            {**TABLE, "push": (RandomPush, push), "curriculum": (Curriculum, {"fields": fields})}
        )


PRESETS = {
    **{f"push=zf_{stage}": [] for stage in ("easy", "medium", "hard", "kneel")},
    **{f"push={name}": [] for name in ("icub", "atalante")},
    **{f"randomization={name}": [] for name in ("zf", "icub")},
    "curriculum=zf": ["+push=zf_easy"],
}


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_make_envs_that_hold_their_specs(compose_config, preset):
    cfg = compose_config(*PRESETS[preset], f"+{preset}", "num_envs=2")
    check_env_specs(instantiate(cfg.env))


@pytest.mark.parametrize("order", [1, -1])
def test_presets_go_together_and_evaluation_leaves_all_of_them_out(compose_config, order):
    presets = ["+push=zf_easy", "+curriculum=zf", "+randomization=zf"][::order]
    cfg = compose_config(*presets, "num_envs=2").env
    check_env_specs(instantiate(cfg))
    kept = {name for name, only in cfg.training_only.items() if not only}
    assert kept == set()
    evaluation = instantiate(cfg, training=False)
    check_env_specs(evaluation)
    made = {type(transform).__name__ for transform in evaluation.transform}
    assert made.isdisjoint({"RandomPush", "Curriculum", "DomainRandomization", "ObservationNoise"})
    assert {"push", "curriculum", "randomization", "noise"} <= set(cfg.training_only)


def test_a_curriculum_over_pushes_and_their_interval_goes_on_for_episodes(compose_config):
    short = "env.transforms.limit.seconds=0.2"
    cfg = compose_config("+push=zf_easy", "+curriculum=zf", "num_envs=3", short)
    env = instantiate(cfg.env)
    td = env.reset()
    for _ in range(16):
        td["action"] = torch.zeros(3, 20)
        _, td = env.step_and_maybe_reset(td)
    assert_close(td["curriculum_level"], torch.full((3, 1), 0.15))  # three episodes, none fell


def test_stages_of_the_zeroth_project_change_pushes_and_their_interval(compose_config):
    env = instantiate(compose_config("+push=zf_easy", "+curriculum=zf", "num_envs=3").env)
    curriculum, push = find(env, Curriculum), find(env, RandomPush)
    curriculum.level = torch.tensor([0.2, 0.5, 1.0])
    curriculum._move()
    assert push.axes["x"][1].tolist() == [20, 40, 100]
    assert push.axes["z"][0].tolist() == [0, 0, -20]
    assert push.timing.interval[1].tolist() == [4, 3, 2]
