"""Tasks by name."""

from pathlib import Path

import gymnasium
import pytest
import torch
from hydra import compose
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

import zfall  # noqa: F401 (registers the names)
from zfall.envs import dm_task, gym
from zfall.envs.tasks import action_bounds, build_task

TABLES = {path.stem for path in (Path(__file__).parents[2] / "recipes" / "env").glob("*.yaml")}


def test_every_table_has_a_name_in_gymnasium():
    names = {name.removeprefix("zfall/") for name in gymnasium.registry if "zfall/" in name}
    assert names == {f"{table.title().replace('_', '')}-v0" for table in TABLES}


@pytest.mark.parametrize("training", [True, False])
@pytest.mark.parametrize("task", sorted(TABLES))
def test_every_task_is_built_by_its_name(task, training):
    env = build_task(task, num_envs=2, training=training)
    check_env_specs(env)
    assert "observation_critic" not in env.observation_spec.keys()


def test_number_of_worlds_is_not_that_of_the_table(compose_config):
    assert build_task(compose_config("num_envs=7").env, num_envs=3).batch_size == (3,)


def test_overrides_reach_the_table():
    env = build_task("push_recovery", num_envs=1, overrides=["env.base_env.control_dt=0.02"])
    assert env.base_env.control_dt == 0.02


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("env.transforms.push.siz=3", "env.transforms.push.siz is not a key .* did you mean size?"),
        ("env.transforms.push.size.y=3", "a list has values 0, 1 .*none that is called y"),
        ("env.base_env.control_dt=0.0401", "env.base_env: control_dt must be a multiple of phy"),
        ("env=icub", "Could not find 'env/icub' Available options in 'env': atalante_standing"),
    ],
)
def test_overrides_that_no_task_can_have_are_refused_in_one_line(override, message):
    with pytest.raises(ValueError, match=message) as refused:
        build_task("push_recovery", num_envs=1, overrides=[override])
    assert "\n" not in str(refused.value)


def test_overrides_to_a_table_are_refused(compose_config):
    with pytest.raises(ValueError, match=r"overrides must be empty when task is a table"):
        build_task(compose_config("num_envs=1").env, num_envs=1, overrides=["env.a=1"])


def test_naming_a_task_leaves_the_hydra_around_it_alone(compose_config):
    from hydra import initialize_config_module

    with initialize_config_module("recipes", version_base=None):
        build_task("push_recovery", num_envs=1)
        assert compose("evaluate").battery.name == "planar"


@pytest.mark.parametrize(("task", "scale"), [("push_recovery", 0.6), ("zeroth_fall", 1.0)])
def test_bounds_of_the_action_reach_the_ends_of_each_joint_and_no_further(task, scale):
    """``reference + scale x bound`` is an end of the range, by the definition of the target."""
    env = build_task(task, num_envs=2, training=False)
    low, high = (torch.from_numpy(bound) for bound in action_bounds(env))
    base = env.base_env
    for bound, end in ((low, 0), (high, 1)):
        assert_close(base.stand_position + scale * bound, base.joint_range[:, end])
        targets = []
        for action in (bound, 1.5 * bound):
            td = env.reset().set("action", action.expand(2, -1))
            targets.append(env.step(td)["next", "target"])
        assert_close(targets[0], base.joint_range[:, end].expand(2, -1))
        assert_close(*targets, atol=1e-6, rtol=0)


def test_velocities_are_bounded_by_one():
    low, high = action_bounds(build_task("icub_balance", num_envs=1))
    assert (low == -1).all()
    assert (high == 1).all()


def test_all_faces_have_the_same_bounds():
    for task in ("push_recovery", "icub_balance"):
        low, high = action_bounds(build_task(task, num_envs=1))
        for face in (gym.TaskEnv(task), gym.TaskVectorEnv(task, num_envs=2)):
            space = getattr(face, "single_action_space", face.action_space)
            assert (space.low == low).all()
            assert (space.high == high).all()
        spec = dm_task.load(task).action_spec()
        assert (spec.minimum == low).all()
        assert (spec.maximum == high).all()
