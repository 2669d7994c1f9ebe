"""Tasks by name."""

from pathlib import Path

import gymnasium
import pytest
from hydra import compose
from torchrl.envs.utils import check_env_specs

import zfall  # noqa: F401 (registers the names)
from zfall.envs.tasks import ACTION_LIMIT, action_bounds, build_task

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


def test_no_servo_reaches_further_than_the_largest_action():
    """The limit is no limit: it turns every servo from its reference to the end of its range."""
    env = build_task("push_recovery", num_envs=1)
    low, high = action_bounds(env)
    assert (high == ACTION_LIMIT).all()
    assert (low == -ACTION_LIMIT).all()
    base = env.base_env
    furthest = (base.joint_range - base.stand_position[:, None]).abs().max().item()
    assert furthest <= 0.6 * ACTION_LIMIT


def test_limit_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match=r"action_limit must be positive, got 0"):
        action_bounds(build_task("push_recovery", num_envs=1), 0.0)
