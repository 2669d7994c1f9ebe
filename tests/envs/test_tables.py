"""What may be changed in the table of a task, what two of them must share, what classes declare."""

from dataclasses import replace

import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf
from omegaconf.errors import ConfigKeyError

from zfall.configs import options_of
from zfall.envs.make import left_out
from zfall.envs.tables import changed, check_same_interface, contents_of, declaring, keep
from zfall.robots.servos import STS3250, datasheets


def test_what_evaluation_leaves_out_can_be_kept_by_its_name(compose_config):
    cfg = compose_config("num_envs=2").env
    assert {"noise", "delay"} <= set(left_out(cfg.training_only))
    assert {"noise", "delay"}.isdisjoint(left_out(keep(cfg, ["noise", "delay"]).training_only))
    with pytest.raises(ValueError, match=r"keep must name what evaluation leaves out .*got action"):
        keep(cfg, ["action"])


@pytest.mark.parametrize(
    ("one", "other", "message"),
    [
        ({"scale": 0.6, "keys": ["a"]}, {"scale": 0.6, "keys": ["b"]}, r"action.keys, got \['a'\] and \['b'\]"),
        ({"scale": 0.6}, {"scale": 0.6, "limit": None}, "action.limit, got nothing and None"),
        ({"in": {"low": 1, "high": 2}}, {"in": {"low": 1, "high": 3}}, "action.in.high, got 2 and 3"),
    ],
)  # fmt: skip
def test_what_differs_between_two_policies_is_named(one, other, message):
    base = {"base_env": {"control_dt": 0.04}}
    configs = {
        name: OmegaConf.create({"env": base | {"transforms": {"action": value, "observation": {}}}})
        for name, value in (("A", one), ("B", other))
    }
    with pytest.raises(ValueError, match=f"A and B must have the same env.transforms.{message}"):
        check_same_interface(configs)


def test_transforms_are_known_by_what_their_class_declares(compose_config):
    quickstart = compose_config().env
    assert set(declaring(quickstart, "replaced_in_batteries")) == {"start", "push"}
    assert declaring(quickstart, "acts_by_itself") == []
    kneel = compose_config("env=push_to_kneel").env
    assert "kneel_reference" in declaring(kneel, "acts_by_itself")
    kneel.transforms.kneel_reference = None  # what is taken out declares nothing
    assert "kneel_reference" not in declaring(kneel, "acts_by_itself")


@pytest.mark.parametrize("task", options_of("env"))
def test_every_task_takes_the_servos_of_the_sheets(compose_config, task):
    """The legs then give 4.99 N m in place of 8.45; the twin's motors, before their gears, 7.21."""
    limits = []
    for servos in ("published", "datasheet"):
        cfg = compose_config(f"env={task}", f"servo={servos}", "num_envs=1").env
        model = instantiate(cfg.base_env, _convert_="all").simulation.model
        limits.append(float(model.actuator("left_knee_pitch").forcerange[1]))
    behind = 4.9033 + 0.0873, 8.4546
    before = (4.9033 * 1.386 + 0.0873) / 0.955
    expected = (
        [before, before]
        if task in ("push_recovery_twin", "push_to_stand")
        else [behind[1], behind[0]]
    )
    assert limits == pytest.approx(expected, rel=1e-4)


def test_published_servos_add_nothing_to_the_config(compose_config):
    """So that runs from before there was a choice stay what they are."""
    assert "servos" not in compose_config("servo=published").env.base_env
    assert compose_config("~experiment", "servo=published") == compose_config("~experiment")


def test_one_joint_takes_another_servo_or_gain_by_one_value(compose_config):
    place = "env.base_env.servos.left_knee_pitch"
    cfg = compose_config("servo=datasheet", f"{place}.kp=22", "num_envs=1").env
    servos = instantiate(cfg.base_env, _convert_="all").servos
    assert (servos["left_knee_pitch"].kp, servos["right_knee_pitch"].kp) == (22, 32)
    cfg = compose_config("servo=datasheet", f"{place}.name=STS3215").env
    servos = instantiate(cfg.base_env, num_envs=1, _convert_="all").servos
    assert servos["left_knee_pitch"].stall_torque == pytest.approx(2.942, abs=1e-3)


def test_servos_can_be_changed_in_the_table_of_a_run(compose_config):
    env = compose_config("servo=published").env
    sheet = changed(env, ["servo=datasheet", "base_env.servos.left_knee_pitch.kp=22"])
    assert sheet.base_env.servos.left_knee_pitch.kp == 22
    assert "servos" not in env.base_env
    assert changed(sheet, ["servo=published"]) == env
    with pytest.raises(ValueError, match="servo must be one of datasheet, published, got 'mine'"):
        changed(env, ["servo=mine"])
    with pytest.raises(ValueError, match="there is no base_env.servos.left_knee_pitch.kp"):
        changed(env, ["base_env.servos.left_knee_pitch.kp=22"])


def test_a_table_of_another_class_replaces_the_whole_of_it(compose_config):
    env = compose_config("env=push_recovery").env
    kick = "{_target_: zfall.envs.transforms.pushes.VelocityKick, velocity: [0.1, 0.2], interval: [1.0, 2.0]}"
    push = changed(env, [f"transforms.push={kick}"]).transforms.push
    assert set(push) == {"_target_", "velocity", "interval"}
    same = f"_target_: {env.transforms.push._target_}, size: [0.7, 0.9]"
    for larger in ("size: [0.7, 0.9]", same):
        push = changed(env, [f"transforms.push={{{larger}}}"]).transforms.push
        assert push == {**env.transforms.push, "size": [0.7, 0.9]}
    with pytest.raises(ValueError, match="change must be KEY=VALUE, got transforms.push"):
        changed(env, ["transforms.push"])
    with pytest.raises(ConfigKeyError, match="sizes"):
        changed(env, ["transforms.push={sizes: [0.7, 0.9]}"])


def test_worlds_with_other_servos_are_told_apart(compose_config, monkeypatch):
    configs = [compose_config(f"servo={name}").env for name in ("published", "datasheet")]
    plain, sheet = ({"env": OmegaConf.to_container(cfg, resolve=True)} for cfg in configs)
    before = contents_of(sheet)
    assert "env.base_env.servos" in set(before) - set(contents_of(plain))
    weaker = replace(STS3250, stall_torque=4.5)
    monkeypatch.setattr(datasheets, "SERVOS", {**datasheets.SERVOS, "STS3250": weaker})
    assert contents_of(sheet) != before  # a number of the package that was corrected, for instance
