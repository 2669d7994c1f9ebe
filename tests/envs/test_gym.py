"""The gymnasium face: its contract, seeds, and what ends an episode."""

import re
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from torch import tensor

from zfall.envs.gym import TaskEnv

ID = "zfall/PushRecovery-v0"
SHORT = ["env.transforms.limit.seconds=0.2"]  # 5 control steps
TILTED = tensor([[0.82, 0.0, 0.57, 0.0]])  # by 1.2 rad: falls at once
UPRIGHT = tensor([[1.0, 0.0, 0.0, 0.0]])


@pytest.fixture
def table(compose_config):
    """Builds the task with the base's orientation at the start given, one row per world."""

    def build(orientation, seconds=0.12) -> dict:
        cfg = compose_config("num_envs=1", f"env.transforms.limit.seconds={seconds}").env
        start = {
            "_target_": "zfall.envs.transforms.starts.ScriptedStart",
            "states": {"base_orientation": orientation},
        }
        out = {k: v for k, v in cfg.transforms.items() if not cfg.training_only.get(k)}
        return {"base_env": cfg.base_env, "transforms": out | {"start": start}}

    return build


@pytest.mark.filterwarnings("ignore:.*recommend using a symmetric and normalized space")
@pytest.mark.filterwarnings("ignore:.*value is -?infinity")
def test_one_world_holds_the_contract_of_gymnasium():
    check_env(gymnasium.make(ID).unwrapped)


def test_name_is_there_after_importing_the_package_which_imports_no_torch():
    code = (
        "import sys, zfall, gymnasium; gymnasium.spec('zfall/PushRecovery-v0');"
        "assert 'torch' not in sys.modules and 'mujoco' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_time_limit_truncates_and_a_fall_terminates(table):
    env = gymnasium.make(ID, training=False, overrides=SHORT)
    env.reset(seed=0)
    ends = [env.step(np.zeros(20))[2:4] for _ in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]
    env = gymnasium.make(ID, task=table(TILTED, 1.0))
    env.reset()
    assert env.step(np.zeros(20))[2:4] == (True, False)


def test_reward_is_the_sum_of_its_terms():
    env = gymnasium.make(ID)
    env.reset(seed=0)
    for _ in range(5):
        _, reward, _, _, info = env.step(env.action_space.sample())
        assert reward == pytest.approx(sum(info["reward_terms"].values()), abs=1e-6)


@pytest.mark.parametrize("make", [gymnasium.make, lambda id: gymnasium.make_vec(id, num_envs=3)])
def test_same_seed_same_run_and_another_seed_another_run(make):
    runs = []
    for seed in (1, 1, 2):
        env = make(ID)
        env.action_space.seed(0)
        values = [env.reset(seed=seed)[0]]
        values += [env.step(0.1 * env.action_space.sample())[0] for _ in range(10)]
        runs.append(np.stack(values))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert np.abs(runs[0] - runs[2]).max() > 0.01


def test_a_seed_takes_a_curriculum_back_to_its_begin():
    """It rises with every episode that is not lost, and pushes with it."""
    env = gymnasium.make("zfall/PushRecoveryRealistic-v0")
    transforms = env.unwrapped.torchrl_env.transform
    (curriculum,) = (t for t in transforms if type(t).__name__ == "Curriculum")
    first = env.reset(seed=3)[0]
    curriculum.level.fill_(0.7)
    curriculum._move()
    np.testing.assert_array_equal(env.reset(seed=3)[0], first)
    assert curriculum.level.tolist() == [0.0]


@pytest.mark.parametrize(
    "make", [gymnasium.make, lambda id, **more: gymnasium.make_vec(id, num_envs=2, **more)]
)
def test_a_stack_of_observations_begins_anew_with_a_seed(make):
    """TorchRL's makes its buffer at the first reset."""
    stack = "+env.transforms.stack={_target_:torchrl.envs.CatFrames,N:3,dim:-1,in_keys:[observation],out_keys:[observation]}"
    env = make(ID, overrides=[stack])
    first = env.reset(seed=2)[0]
    env.step(np.zeros(env.action_space.shape))
    np.testing.assert_array_equal(env.reset(seed=2)[0], first)


def test_without_a_seed_two_envs_differ():
    starts = [gymnasium.make(ID).reset()[0] for _ in range(2)]
    assert np.abs(starts[0] - starts[1]).max() > 1e-3


def test_many_worlds_report_as_single_ones_that_gymnasium_puts_together(table):
    """Its SyncVectorEnv in the same mode is the reference, infos and masks included."""
    starts = [UPRIGHT, TILTED, UPRIGHT]
    alone = [lambda start=start: gymnasium.make(ID, task=table(start)) for start in starts]
    reference = SyncVectorEnv(alone, autoreset_mode=AutoresetMode.SAME_STEP)
    start = tensor(np.concatenate(starts))
    env = gymnasium.make_vec(ID, num_envs=3, task=table(start))
    assert env.metadata["autoreset_mode"] == reference.metadata["autoreset_mode"]
    assert env.action_space == reference.action_space
    assert env.observation_space == reference.observation_space
    assert_same(env.reset(), reference.reset())
    generator = np.random.default_rng(0)
    ended = []
    for _ in range(8):
        actions = 0.1 * generator.standard_normal((3, 20)).astype(np.float32)
        mine, theirs = env.step(actions), reference.step(actions)
        assert_same(mine, theirs)
        ended.append(mine[2] | mine[3])
    assert np.stack(ended).any(0).all()  # by a fall or by the limit
    assert not np.stack(ended).all(1).all()


def assert_same(mine, theirs, place="") -> None:
    """Equal in structure, types and values."""
    if isinstance(theirs, dict):
        assert mine.keys() == theirs.keys(), place
        for key in theirs:
            assert_same(mine[key], theirs[key], f"{place}.{key}")
    elif isinstance(theirs, tuple):
        assert len(mine) == len(theirs)
        for index, (a, b) in enumerate(zip(mine, theirs, strict=True)):
            assert_same(a, b, f"{place}.{index}")
    elif theirs is None:
        assert mine is None, place
    else:
        assert mine.dtype == theirs.dtype, place
        assert mine.shape == theirs.shape, place
        if theirs.dtype == object:
            for a, b in zip(mine, theirs, strict=True):
                assert_same(a, b, place)
        else:
            np.testing.assert_allclose(mine, theirs, rtol=1e-6, atol=1e-6, err_msg=place)


def test_what_a_step_gives_is_not_changed_by_the_next():
    env = gymnasium.make_vec(ID, num_envs=2)
    first, _ = env.reset(seed=0)
    kept = first.copy()
    after = env.step(env.action_space.sample())
    reward = after[1].copy()
    env.step(env.action_space.sample())
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(after[1], reward)


def test_options_and_lists_of_seeds_are_refused():
    with pytest.raises(ValueError, match=r"options must be empty.*got pose"):
        gymnasium.make(ID).reset(options={"pose": 1})
    env = gymnasium.make_vec(ID, num_envs=2)
    with pytest.raises(ValueError, match=r"seed must be one number for all worlds, got \[1, 2\]"):
        env.reset(seed=[1, 2])


def test_actions_of_another_shape_or_not_finite_are_refused():
    one, many = gymnasium.make(ID).unwrapped, gymnasium.make_vec(ID, num_envs=3)
    one.reset(seed=0)
    many.reset(seed=0)
    for env, shape, wrong in ((one, (20,), (1,)), (many, (3, 20), (3, 1)), (many, (3, 20), (20,))):
        with pytest.raises(ValueError, match=re.escape(f"shape {shape}, got {wrong}")):
            env.step(np.ones(wrong, dtype=np.float32))
    broken = np.zeros((3, 20), dtype=np.float32)
    broken[1, 4] = np.nan
    with pytest.raises(ValueError, match="action must be finite, got nan"):
        many.step(broken)
    assert np.isfinite(many.step(np.zeros((3, 20), dtype=np.float32))[1]).all()
    with pytest.raises(ValueError, match="render_mode must be rgb_array or None, got 'human'"):
        TaskEnv(render_mode="human")


def test_picture_shows_the_robot():
    env = gymnasium.make(ID, render_mode="rgb_array")
    env.reset(seed=0)
    try:
        picture = env.render()
    except (ImportError, RuntimeError, AttributeError, OSError):
        pytest.skip("no OpenGL on this machine")
    finally:
        env.close()
    assert picture.shape == (480, 640, 3)
    assert picture.std() > 10


def test_stable_baselines_trains_on_it():
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_util import make_vec_env

    env = make_vec_env(ID, n_envs=2, seed=0)
    model = sb3.PPO("MlpPolicy", env, n_steps=64, batch_size=64, n_epochs=2, seed=0, device="cpu")
    before = model.policy.action_net.weight.detach().clone()
    model.learn(256)
    after = model.policy.action_net.weight
    assert after.isfinite().all()
    assert (after != before).any()


def ending(mode):
    """A vector env two of whose worlds time out after three steps."""
    return gymnasium.make_vec(
        "zfall/PushRecovery-v0", num_envs=2, training=False, autoreset_mode=mode,
        overrides=["env.transforms.limit.seconds=0.12"],
    )  # fmt: skip


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_worlds_begin_anew_when_the_mode_says_so(mode):
    envs = ending(mode)
    assert envs.metadata["autoreset_mode"] is mode
    start, _ = envs.reset(seed=0)
    still = np.zeros((2, 20), np.float32)
    for _ in range(2):
        _observation, *_ = envs.step(still)
    last, reward, terminated, truncated, info = envs.step(still)
    assert truncated.all()
    assert not terminated.any()
    assert (reward > 0).all()
    if mode is AutoresetMode.SAME_STEP:
        assert np.array_equal(last, start)  # without noise every start is the same
        assert not np.array_equal(info["final_obs"][0], start[0])
        return
    assert not np.array_equal(last, start)
    assert "final_obs" not in info
    if mode is AutoresetMode.NEXT_STEP:
        after, reward, terminated, truncated, info = envs.step(np.ones((2, 20), np.float32))
        assert not (terminated | truncated).any()
        assert not reward.any()
        assert info == {}
    else:
        after, _ = envs.reset(options={"reset_mask": np.array([True, False])})
        assert np.array_equal(after[1], last[1])
        after = after[[0, 0]]
    assert np.array_equal(after, start)


def test_a_world_that_begins_in_the_next_step_has_a_whole_episode():
    envs, steps = ending("NEXT_STEP"), []
    envs.reset(seed=0)
    for step in range(9):
        *_, truncated, _ = envs.step(np.zeros((2, 20), np.float32))
        steps += [step] if truncated.all() else []
    assert steps == [2, 6]  # three steps, then one that does not count


@pytest.mark.parametrize(
    ("mode", "options", "said"),
    [
        ("SAME_STEP", {"reset_mask": np.ones(2, bool)}, r"autoreset_mode=AutoresetMode.DISABLED"),
        ("DISABLED", {"reset_mask": np.ones(3, bool)}, r"reset_mask must be \(2,\) bool, got \(3,\)"),
        ("DISABLED", {"reset_mask": np.ones(2)}, r"reset_mask must be .* float64"),
        ("DISABLED", {"mask": 1}, r"options must be empty"),
    ],
)  # fmt: skip
def test_resets_of_some_worlds_are_checked(mode, options, said):
    envs = ending(mode)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=said):
        envs.reset(options=options)


def test_an_unknown_mode_of_resets_is_refused():
    with pytest.raises(ValueError, match=r"autoreset_mode must be one of NEXT_STEP.* got 'later'"):
        ending("later")


def test_all_worlds_are_rendered():
    envs = gymnasium.make_vec("zfall/PushRecovery-v0", num_envs=2, render_mode="rgb_array")
    envs.reset(seed=0)
    pictures = envs.render()
    assert len(pictures) == 2
    assert pictures[0].shape == (480, 640, 3)
    assert pictures[0].dtype == np.uint8
    assert pictures[0].std() > 5  # something is to be seen
    envs.close()
