"""A task's env with what TorchRL's users put around it and into it."""

import subprocess
import sys

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch.testing import assert_close
from torchrl.envs import (
    ActionDiscretizer,
    Compose,
    FrameSkipTransform,
    MultiAction,
    NoopResetEnv,
    SerialEnv,
    TransformedEnv,
)
from torchrl.envs.utils import check_env_specs
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal
from torchrl.record import PixelRenderTransform

from tests.envs.test_table_env import assert_same
from tests.envs.transforms.pushes.test_momentum import floating
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.tasks import build_task
from zfall.envs.terms.posture import survival
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.pushes import RandomPush
from zfall.envs.transforms.rewards import WeightedReward
from zfall.envs.transforms.windows import LastAction
from zfall.robots import ZEROTH01


def task(num_envs: int = 2) -> TransformedEnv:
    return build_task("push_recovery", num_envs=num_envs)


def plain(*more: object) -> TransformedEnv:
    """What a user may put together without ``make_env``."""
    base = HumanoidEnv(num_envs=2, control_dt=0.04)
    action = JointPositionTarget(base, scale=0.6)
    push = RandomPush(base, point="torso", impulse=[0.2, 0.2], interval=[0.1, 0.2], duration=0.1)
    reward = WeightedReward(base, terms={"survival": (1.0, survival)})
    return TransformedEnv(base, Compose(push, action, reward, *more))


@pytest.mark.parametrize(
    "put",
    [
        lambda repeat: task().append_transform(repeat),
        lambda repeat: task().insert_transform(0, repeat),
        lambda repeat: TransformedEnv(task(), repeat),
        lambda repeat: TransformedEnv(task(), Compose(repeat), auto_unwrap=False),
        lambda repeat: TransformedEnv(SerialEnv(2, task), repeat),
        lambda repeat: SerialEnv(2, lambda: task().append_transform(repeat.clone())),
        plain,
        lambda repeat: plain(Compose(repeat)),
        lambda repeat: TransformedEnv(plain(), repeat, auto_unwrap=False),
        lambda repeat: TransformedEnv(plain(), repeat, auto_unwrap=True),
    ],
)
def test_an_action_repeated_behind_the_env_is_refused(put):
    with pytest.raises(ValueError, match="FrameSkipTransform.* longer control_dt"):
        put(FrameSkipTransform(2)).rollout(3)


@pytest.mark.parametrize("several", [MultiAction, NoopResetEnv])
def test_transforms_that_step_copies_of_others_are_refused(several):
    for env in (task().append_transform(several()), plain(several())):
        with pytest.raises(ValueError, match=f"{several.__name__} must not be among"):
            env.reset()


def test_a_step_from_before_the_last_one_is_refused():
    env = task()
    td = env.rand_action(env.reset())
    env.step(td.copy())
    with pytest.raises(ValueError, match="go on with step_mdp"):
        env.step(td.copy())


def test_one_tensordict_may_be_stepped_again_and_again_by_hand():
    """As in TorchRL's own tutorials."""
    env = task()
    td = env.reset()
    for _ in range(3):
        td = env.rand_step(td)


def test_several_actions_around_the_env_are_as_many_steps_of_it():
    """With pushes, delays, noise and rewards; the last of the steps is what is returned."""
    one, other = task(), task()
    several = TransformedEnv(other, MultiAction(stack_rewards=False))
    actions = 0.3 * torch.randn(4, 2, 3, 20)
    td, td_several = one.reset(), several.reset()
    for chunk in actions:
        for action in chunk.unbind(1):
            data, td = one.step_and_maybe_reset(td.copy().set("action", action))
        data_several, td_several = several.step_and_maybe_reset(td_several.set("action", chunk))
        assert_same(data["next"], data_several["next"])


def test_the_impulse_of_a_push_is_exact_under_several_actions():
    """In the air, 0.2 N s: read from the momentum of the robot."""
    push = {"point": "torso", "duration": 0.1, "time": 0.053, "plan": [2.0, 0.0, 0.0]}
    env = TransformedEnv(floating(ZEROTH01, 0.02, 0.001, **push), MultiAction())
    td = env.reset()
    env.base_env.base_env.simulation.qpos[:, 2] = 5.0
    for _ in range(5):
        td = env.step(td.set("action", torch.zeros(1, 3, 20)))["next"]
    assert_close(td["linear_momentum"], torch.tensor([[0.2, 0.0, 0.0]]), atol=2e-3, rtol=0)


def test_the_actor_of_torchrls_tutorial_acts_within_the_bounds():
    env = task(4)
    bounds = env.action_spec_unbatched
    layers = [torch.nn.Linear(66, 64), torch.nn.Tanh(), torch.nn.Linear(64, 40)]
    net = torch.nn.Sequential(*layers, NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictModule(net, in_keys=["observation"], out_keys=["loc", "scale"]),
        spec=bounds,
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs={"low": bounds.space.low, "high": bounds.space.high},
        return_log_prob=True,
    )
    rollout = env.rollout(200, actor, break_when_any_done=False)
    assert [key for key, v in rollout.items(True, True) if not v.float().isfinite().all()] == []
    assert not rollout["next", "diverged"].any()
    assert (rollout["action"] <= bounds.space.high + 1e-5).all()
    assert (rollout["action"] >= bounds.space.low - 1e-5).all()


@pytest.mark.parametrize("put", [TransformedEnv, lambda env, t: env.append_transform(t)])
def test_torchrls_discretizer_acts_from_end_to_end_of_the_range(put):
    env = put(
        task(), ActionDiscretizer(num_intervals=3, sampling=ActionDiscretizer.SamplingStrategy.LOW)
    )
    check_env_specs(env)
    low = env.joint_range[:, 0]
    td = env.reset().set("action", torch.zeros(2, 20, dtype=torch.long))
    assert_close(env.step(td)["next", "target"], low.expand(2, -1), atol=1e-5, rtol=0)


def test_random_actions_lie_within_the_bounds_and_reach_the_policy_as_they_are():
    env = make_env(
        base := HumanoidEnv(num_envs=2, control_dt=0.04),
        {"action": JointPositionTarget(base, scale=0.6), "last": LastAction()},
    )
    rollout = env.rollout(5)
    assert env.action_spec_unbatched.is_in(rollout["action"])
    assert torch.equal(rollout["next", "last_action"], rollout["action"])


def test_worlds_are_rendered_into_pixels():
    env = task()
    pictures = env.render(height=48, width=64)
    assert pictures.shape == (2, 48, 64, 3)
    assert pictures.std() > 5  # something is to be seen
    env.append_transform(PixelRenderTransform(height=48, width=64))
    check_env_specs(env)
    pixels = env.rollout(3)["next", "pixels"]
    assert pixels.dtype == torch.uint8
    assert pixels.shape == (2, 3, 48, 64, 3)
    assert not torch.equal(pixels[:, 0], pixels[:, 2])
    env.base_env.camera.close()


@pytest.mark.parametrize(
    "order", ["import torchrl.envs, zfall", pytest.param("import zfall", marks=pytest.mark.slow)]
)
def test_an_unknown_opengl_is_named_when_a_picture_is_wanted(order):
    code = f"{order}; from zfall.envs.tasks import build_task as b; b('push_recovery', num_envs=1)"
    code += ".render()"
    done = subprocess.run(
        [sys.executable, "-c", code], env={"MUJOCO_GL": "nonsense", "PATH": ""}, text=True,
        capture_output=True, check=False,
    )  # fmt: skip
    assert "MUJOCO_GL" in done.stderr.splitlines()[-1]
    assert "nonsense" in done.stderr.splitlines()[-1]


def test_more_worlds_than_there_is_memory_for_are_refused_before_it_is_taken():
    with pytest.raises(ValueError, match=r"num_envs must fit .* got 1000000000, which .* GiB"):
        HumanoidEnv(num_envs=10**9, control_dt=0.04)
