"""A robot's hardware in the place of that of any env."""

import pytest

from zfall.envs.make import in_place
from zfall.envs.worlds import check_world, in_world, privileged
from zfall.evaluation.battery import battery_env
from zfall.evaluation.definitions import load_battery
from zfall.policies.load import load_policy

ACTIONS = "zfall.envs.transforms.actions"
DELAY = {"_target_": f"{ACTIONS}.ActuatorDelay", "delay": [0.01, 0.01]}
PLANNER = {"_target_": f"{ACTIONS}.ServoPlanner", "before": "late"}
SPEED = {"_target_": "zfall.envs.transforms.estimation.NumericalVelocity"}


def names(cfg) -> list[str]:
    return [str(name) for name in in_place(cfg.transforms)]


def test_only_hardware_of_the_kinds_that_a_world_has_is_replaced(compose_config):
    cfg = compose_config("env=push_recovery_realistic").env
    new = names(in_world(cfg, {"commands": {"late": DELAY, "planner": PLANNER}}))
    assert set(names(cfg)) - set(new) == {"delay", "planner", "deadband", "backlash"}
    assert new[-2:] == ["world_planner", "world_late"]  # last on the way to the motors
    rest = [name for name in names(cfg) if name in new]
    assert new[:-2] == rest


def test_an_estimator_gives_way_to_that_of_the_policy(compose_config):
    world = {"sensors": {"speed": SPEED}}
    with_own = compose_config("env=push_recovery_realistic").env
    assert "world_speed" not in names(in_world(with_own, world))
    assert names(in_world(with_own, world))[0] == "start"
    assert names(in_world(compose_config().env, world))[0] == "world_speed"  # before all others
    left_out = compose_config("env=push_recovery_realistic", "+env.training_only.speed=true").env
    assert names(in_world(left_out, world))[0] == "world_speed"


def test_without_a_world_nothing_changes_and_base_env_takes_its_values(compose_config):
    cfg = compose_config().env
    assert in_world(cfg, None) is cfg
    assert in_world(cfg, {"base_env": {"physics_dt": 0.002}}).base_env.physics_dt == 0.002
    assert cfg.base_env.physics_dt == 0.004


def test_a_place_before_hardware_that_goes_is_kept(compose_config):
    mine = "{_target_: zfall.envs.transforms.actions.LowPass, time_constant: 0.1, before: delay}"
    cfg = compose_config(f"+env.transforms.mine={mine}").env
    table = names(in_world(cfg, {"commands": {"late": DELAY}}))
    assert table.index("action") < table.index("mine") < table.index("push")


SERVO = {"_target_": "zfall.robots.servos.servo", "name": "STS3250"}


@pytest.mark.parametrize(
    ("world", "message"),
    [
        ({"motors": {}}, "world must be null or have tables .*got motors"),
        (3, "world must be null or have tables .*got 3"),
        ({"commands": 3}, "world.commands must be a table, got 3"),
        ({"commands": {"late": {**DELAY, "dely": 1}}}, "world.commands.*late.dely"),
        ({"commands": {"late": {**DELAY, "delay": [2, 1]}}}, "world.commands.*late.delay"),
        (
            {"base_env": {"servos": {"knee": {**SERVO, "x": 1}}}},
            "world.base_env.servos.knee: x must",
        ),
    ],
)
def test_what_is_no_world_is_refused(world, message):
    with pytest.raises(ValueError, match=message):
        check_world(world)


def test_a_battery_refuses_what_is_no_world():
    world = {"commands": {"late": {**DELAY, "delay": [2, 1]}}}
    with pytest.raises(ValueError, match="battery.world.commands.*late.delay must be two numbers"):
        load_battery("planar", world=world)


def test_names_of_a_world_are_its_own(compose_config):
    cfg = compose_config("+env.transforms.world_late=${env.transforms.delay}").env
    with pytest.raises(ValueError, match="transforms.world_late must not begin with world_"):
        in_world(cfg, {"commands": {"late": DELAY}})


@pytest.mark.parametrize(
    ("policy", "true_ones"),
    [
        ("best", ["com_velocity", "feet_force"]),
        ("zeroth_fall", []),
        ("atalante", ["feet_corner_force"]),
    ],
)
def test_what_a_policy_sees_that_no_robot_measures_is_named(policy, true_ones):
    env, _, _ = battery_env(load_battery("twin"), load_policy(policy).config.env, 2)
    assert privileged(env) == true_ones


def test_a_policy_of_the_twin_sees_nothing_but_what_is_measured(compose_config):
    env, _, _ = battery_env(load_battery("twin"), compose_config("env=push_recovery_twin").env, 2)
    assert privileged(env) == []
