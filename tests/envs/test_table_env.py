"""A task's env as TorchRL's users treat it: saved, copied, given bad actions."""

import copy
import pickle
import subprocess
import sys

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.checkpoint import Checkpoint
from torchrl.envs import CatFrames, TransformedEnv
from torchrl.envs.utils import check_env_specs

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.tasks import build_task
from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget
from zfall.robots import ZEROTH01

TASKS = ("push_recovery_realistic", "push_to_kneel")


def go_on(
    env: TransformedEnv, td: TensorDictBase, steps: int, seed: int
) -> tuple[TensorDictBase, TensorDictBase]:
    """Some steps with random actions, worlds that end begin anew; all that came of it."""
    actions = torch.randn(steps, *env.action_spec.shape, generator=torch.manual_seed(seed))
    rows = []
    for action in 0.8 * actions:
        data, td = env.step_and_maybe_reset(td.copy().set("action", action))
        rows.append(data)
    return torch.stack(rows, 1), td


def assert_same(one: TensorDictBase, other: TensorDictBase) -> None:
    differ = [key for key in one.keys(True, True) if not torch.equal(one[key], other[key])]
    assert set(one.keys(True, True)) == set(other.keys(True, True))
    assert not differ


@pytest.mark.parametrize("task", TASKS)
def test_a_restored_a_copied_and_a_pickled_env_go_on_bit_for_bit(task):
    env = build_task(task, num_envs=3)
    _, td = go_on(env, env.reset(), 30, seed=1)
    state = env.state_dict()
    restored = build_task(task, num_envs=3)
    restored.load_state_dict(state)
    copied, pickled = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    expected, _ = go_on(env, td, 40, seed=2)
    assert expected["next", "done"].any()
    for other in (restored, copied, pickled):
        assert_same(expected, go_on(other, td, 40, seed=2)[0])
    env.load_state_dict(state)  # which the steps since have not changed
    assert_same(expected, go_on(env, td, 40, seed=2)[0])


def test_a_state_stays_as_it_is_when_tensors_are_changed_in_place():
    env = build_task("push_recovery", num_envs=3)
    _, td = go_on(env, env.reset(), 5, seed=1)
    state = env.state_dict()
    observed = {key: value.clone() for key, value in state["base_env"]["observed"].items()}
    td.zero_()
    env.load_state_dict(state)
    env.reset(td.set("_reset", torch.tensor([[True], [False], [False]]))).zero_()
    assert observed["base_position"].any()
    for key, value in observed.items():
        assert torch.equal(state["base_env"]["observed"][key], value), key


def test_the_base_env_is_copied_with_what_differs_by_world():
    env = HumanoidEnv(num_envs=2, control_dt=0.04)
    env.simulation.model.opt.gravity[2] = -5.0
    factor = torch.tensor([[0.5], [1.0]])
    env.set_physics_params(TensorDict({"battery_voltage": factor}, [2]))
    other = pickle.loads(pickle.dumps(env))
    td = env.reset().set("target", 0.5 * torch.ones(2, 20))
    assert_same(env.step(td.copy()), other.step(other.reset().set("target", td["target"])))
    assert other.simulation.model_of(0).actuator_gainprm[0, 0] == pytest.approx(
        0.5 * other.simulation.model_of(1).actuator_gainprm[0, 0]
    )


RESUME = """
import sys, torch
from torchrl.checkpoint import Checkpoint
from tests.envs.test_table_env import go_on
from zfall.envs.tasks import build_task
env = build_task("push_recovery_realistic", num_envs=3)
Checkpoint(env=env).load(sys.argv[1])
td = torch.load(sys.argv[1] + "/td.pt", weights_only=False)
torch.save(go_on(env, td, 20, seed=2)[0]["next", "observation"], sys.argv[1] + "/after.pt")
"""


@pytest.mark.long
def test_torchrls_checkpoint_restores_an_env_in_another_process(tmp_path):
    env = build_task("push_recovery_realistic", num_envs=3)
    _, td = go_on(env, env.reset(), 20, seed=1)
    Checkpoint(env=env).save(tmp_path / "saved")
    torch.save(td, tmp_path / "saved" / "td.pt")
    subprocess.run([sys.executable, "-c", RESUME, str(tmp_path / "saved")], check=True)
    expected = go_on(env, td, 20, seed=2)[0]["next", "observation"]
    assert torch.equal(torch.load(tmp_path / "saved" / "after.pt"), expected)


def test_frames_stacked_by_torchrl_are_restored_too():
    def build():
        env = build_task("push_recovery", num_envs=2)
        stack = CatFrames(N=3, dim=-1, in_keys=["observation"], out_keys=["stacked"])
        return env.append_transform(stack)

    env, fresh = build(), build()
    env.load_state_dict(fresh.state_dict())  # from before the first reset
    _, td = go_on(env, env.reset(), 5, seed=1)
    fresh.load_state_dict(env.state_dict())
    expected, _ = go_on(env, td, 5, seed=2)
    assert_same(expected, go_on(fresh, td, 5, seed=2)[0])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"num_envs": 3}, r"num_envs, 3, got 2"),
        ({"overrides": ["env.transforms.delay=null"]}, r"transform\.\S+ differs"),
        ({"overrides": ["env.base_env.control_dt=0.02"]}, r"control_dt, 0.02, got 0.04"),
        (
            {
                "overrides": [
                    "+env.base_env.ball={_target_: zfall.robots.Ball, mass: 0.2, radius: 0.04}"
                ]
            },
            r"ball .* got",
        ),
    ],
)
def test_the_state_of_another_env_is_refused(change, said):
    state = build_task("push_recovery", num_envs=2).state_dict()
    other = build_task(**{"task": "push_recovery", "num_envs": 2} | change)
    before = other.state_dict()
    with pytest.raises(ValueError, match=said):
        other.load_state_dict(state)
    assert str(before["base_env"]["streams"]) == str(other.base_env.streams.state_dict())


def test_the_state_of_another_robot_is_refused(make_base):
    from dataclasses import replace

    other = replace(ZEROTH01, name="other")
    with pytest.raises(ValueError, match=r"robot, other .*, got zeroth"):
        make_base(robot=other).load_state_dict(make_base().state_dict())


@pytest.mark.parametrize(
    ("task", "value"),
    [
        ("push_recovery_realistic", torch.nan),
        ("push_recovery_realistic", -torch.inf),
        ("icub_balance", torch.inf),
    ],
)
def test_an_action_that_is_not_finite_ends_its_world_alone(task, value):
    """As failed physics does; the other worlds do not notice, and the next episode is sound."""
    one, two = (build_task(task, num_envs=3) for _ in range(2))
    tds = [env.reset() for env in (one, two)]
    for step in range(10):
        action = 0.5 * torch.randn(one.action_spec.shape)
        bad = action.clone()
        if step == 3:
            bad[1, 4] = value
        sound, tds[0] = one.step_and_maybe_reset(tds[0].copy().set("action", action))
        data, tds[1] = two.step_and_maybe_reset(tds[1].copy().set("action", bad))
        after = data["next"]
        others = torch.tensor([0, 2])
        if step == 3:
            for flag in ("diverged", "terminated", "done"):
                assert after[flag][1]
            assert tds[1]["done"].logical_not().all()
        for key, entry in data.items(True, True):
            assert entry.float().isfinite().all(), key
            # Randomness is drawn for all worlds at a reset: until then the others are the same.
            if step <= 3:
                assert torch.equal(entry[others], sound[key][others]), key


def test_a_target_that_is_not_finite_ends_its_world(make_base):
    env = make_base(num_envs=2)
    target = env.stand_position.repeat(2, 1)
    sound = env.step(env.reset().set("target", target))
    target = target.clone()
    target[1, 3] = torch.nan
    after = env.step(env.reset().set("target", target))["next"]
    assert after["diverged"].flatten().tolist() == [False, True]
    assert after["terminated"].flatten().tolist() == [False, True]
    assert after["joint_position"].isfinite().all()
    assert torch.equal(after["joint_position"][0], sound["next", "joint_position"][0])


def test_what_a_transform_makes_not_finite_ends_its_world():
    env = build_task("push_recovery", num_envs=3)

    def spoil(td: TensorDictBase) -> TensorDictBase:
        if "reward" in td.keys():
            td["observation"] = td["observation"].clone()
            td["observation"][2, 5] = torch.inf
        return td

    env.append_transform(spoil)
    after = env.step(env.reset().set("action", torch.zeros(3, 20)))["next"]
    assert after["diverged"].flatten().tolist() == [False, False, True]
    assert after["done"].flatten().tolist() == [False, False, True]
    assert after["observation"].isfinite().all()
    assert after["observation"][2, 5] == 0


def test_one_number_of_a_world_that_is_not_finite_ends_it_too():
    env = build_task("push_recovery", num_envs=3)
    bad = torch.tensor([0.0, torch.nan, 0.0])
    good = torch.zeros(3)
    env.append_transform(lambda td: td.set("height", bad if "reward" in td.keys() else good))
    after = env.step(env.reset().set("action", torch.zeros(3, 20)))["next"]
    assert after["done"].flatten().tolist() == [False, True, False]
    assert after["height"].tolist() == [0.0, 0.0, 0.0]


def test_a_reset_that_is_not_finite_is_refused_by_its_key():
    env = build_task("push_recovery", num_envs=2)
    env.append_transform(lambda td: td.set("observation", td["observation"] * torch.nan))
    with pytest.raises(ValueError, match=r"finite values, got nan in observation"):
        env.reset()


@pytest.mark.parametrize("task", TASKS)
def test_what_transforms_remember_is_clean_after_a_reset(task):
    """NaN in any memory of a world is gone with its episode, and other worlds have none of it."""
    env = build_task(task, num_envs=7)
    _, td = go_on(env, env.reset(), 5, seed=1)
    for name, buffer in env.transform.named_buffers():
        per_world = buffer.is_floating_point() and buffer.shape[:1] == (7,)
        if per_world and not name.endswith("level"):
            buffer[1] = torch.nan
    td["_reset"] = torch.arange(7)[:, None] == 1
    td = env.reset(td)
    after, _ = go_on(env, td, 5, seed=2)
    for key, entry in after["next"].items(True, True):
        assert entry.float().isfinite().all(), key
    assert not after["next", "diverged"].any()


@pytest.mark.parametrize("shape", [(4, 1), (1, 20), (20,), (4, 19), (4, 20, 1)])
def test_an_action_of_another_shape_is_refused(shape):
    env = build_task("push_recovery", num_envs=4)
    td = env.reset()
    td = td.auto_batch_size_(1) if len(shape) > 1 and shape[0] == 4 else td
    with pytest.raises((ValueError, RuntimeError), match=r"shape|batch"):
        env.step(TensorDict({**td}, [4]).set("action", torch.zeros(shape)))


def test_float64_actions_become_float32_targets():
    env = build_task("push_recovery", num_envs=2)
    action = 0.3 * torch.randn(2, 20)
    td = env.reset()
    state = env.state_dict()
    single = env.step(td.copy().set("action", action))["next"]
    env.load_state_dict(state)
    double = env.step(td.copy().set("action", action.double()))["next"]
    assert double["target"].dtype == torch.float32
    assert_same(single, double)


@pytest.mark.parametrize("task", ["push_recovery_realistic", "icub_balance"])
def test_gradients_end_where_the_physics_begins(task):
    env = build_task(task, num_envs=2)
    size = env.observation_spec["observation"].shape[-1]
    layer = torch.nn.Linear(size, 20)

    def policy(td: TensorDictBase) -> TensorDictBase:
        return td.set("action", layer(td["observation"]))

    rollout = env.rollout(10, policy, break_when_any_done=False)
    assert rollout["action"].requires_grad
    assert not [key for key, v in rollout["next"].items(True, True) if v.requires_grad]
    rollout["action"].sum().backward()
    assert layer.weight.grad.isfinite().all()
    assert not any(buffer.requires_grad for buffer in env.transform.buffers())


def test_specs_hold_of_a_task_with_bounds():
    check_env_specs(build_task("push_recovery_realistic", num_envs=2))


def test_a_plain_env_of_torchrl_checks_actions_too(make_base):
    base = make_base(num_envs=2)
    command = ActuatorDelay(base, delay=(0.0, 0.008)), JointPositionTarget(base, scale=0.6)
    env = TransformedEnv(base, command[0]).append_transform(command[1])
    with pytest.raises(ValueError, match=r"action must have the shape \(2, 20\).* got \(2, 1\)"):
        env.step(env.reset().set("action", torch.zeros(2, 1)))
    bad = torch.tensor([[0.0], [torch.nan]]).expand(2, 20)
    assert env.step(env.reset().set("action", bad))["next", "diverged"].flatten().tolist() == [
        False,
        True,
    ]


@pytest.mark.parametrize(
    ("key", "shape", "said"),
    [
        ("wrench", (2, 1, 1, 6), r"push.wrench .* got \(2, 1"),
        ("kick", (2, 1), r"push.kick .* got \(2"),
    ],
)
def test_a_push_of_another_shape_is_refused(make_base, key, shape, said):
    env = make_base(num_envs=2)
    td = env.reset().set("target", env.stand_position.repeat(2, 1))
    with pytest.raises(ValueError, match=said):
        env.step(td.set(("push", key), torch.ones(shape)))


@pytest.mark.parametrize("lost", ["parameters", "streams", "streams.at", "simulation.sensors"])
def test_a_state_that_lacks_something_is_refused_before_anything_changes(make_base, lost):
    env = make_base(num_envs=2)
    state = env.state_dict()
    *within, key = lost.split(".")
    del (state[within[0]] if within else state)[key]
    env.reset()
    before = env.simulation.state_dict()
    with pytest.raises(ValueError, match=r"an env's state must"):
        env.load_state_dict(state)
    assert torch.equal(env.simulation.state_dict()["state"], before["state"])
