"""Tables of transforms: their order, outside transforms, what evaluation leaves out."""

import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from tensordict import TensorDictBase
from torch.testing import assert_close
from torchrl.envs import Transform
from torchrl.envs.utils import check_env_specs

from zfall.configs import options_of
from zfall.envs.make import make_env
from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget
from zfall.envs.transforms.observations import ObservationNoise
from zfall.envs.transforms.pushes import RandomPush


class DoubleTarget(Transform):
    """A user's own transform: the servos get twice the angle."""

    def __init__(self):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["target"])

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        return tensordict.set("target", 2 * tensordict["target"])


OUTSIDE = {"_target_": "tests.envs.test_make.DoubleTarget"}


def table(**more: object) -> dict[str, object]:
    action = {"_target_": "zfall.envs.transforms.actions.JointPositionTarget", "scale": 0.5}
    delay = {"_target_": "zfall.envs.transforms.actions.ActuatorDelay", "delay": [0.0, 0.0]}
    return {"action": action, **more, "delay": delay}


@pytest.mark.parametrize("task", options_of("env"))
def test_every_task_of_the_recipes_holds_its_specs(compose_config, task):
    cfg = compose_config(f"env={task}", "num_envs=3")
    check_env_specs(instantiate(cfg.env))


def test_transform_of_a_user_runs_where_the_table_puts_it(make_base):
    base = make_base(num_envs=2)
    env = make_env(base, table(mine=OUTSIDE))
    seen = {}
    base._step = lambda td: seen.update(td.items()) or HumanoidStep(base, td)
    td = env.reset()
    td["action"] = torch.full((2, 20), 0.1)
    env.step(td)
    expected = 2 * (base.stand_position + 0.05)
    torch.testing.assert_close(seen["control"][0, 0], expected)


def HumanoidStep(base, td):
    return type(base)._step(base, td)


def test_transform_of_a_user_can_be_named_from_yaml(compose_config):
    cfg = compose_config(
        "num_envs=2",
        "+env.transforms.mine={_target_: tests.envs.test_make.DoubleTarget,before: delay}",
    )
    env = instantiate(cfg.env)
    assert any(isinstance(t, DoubleTarget) for t in env.transform)


def test_evaluation_leaves_out_what_the_table_says_and_nothing_else(compose_config):
    cfg = compose_config("num_envs=2").env
    kinds = {}
    for training in (True, False):
        env = instantiate(cfg, training=training)
        kinds[training] = {type(t) for t in env.transform}
    gone = {RandomPush, ObservationNoise, ActuatorDelay}
    assert gone <= kinds[True]
    assert not gone & kinds[False]
    assert JointPositionTarget in kinds[False]


def test_null_takes_a_transform_out_of_the_table(compose_config):
    cfg = compose_config("num_envs=2", "env.transforms.noise=null").env  # training_only names it
    names = {type(t) for t in instantiate(cfg).transform}
    assert ObservationNoise not in names
    assert RandomPush in names


def test_unknown_name_in_training_only_is_refused(make_base):
    with pytest.raises(ValueError, match=r"training_only must name transforms .*got wind"):
        make_env(make_base(), table(), training_only=["wind"])


def test_unknown_value_of_a_transform_is_refused_with_its_place(compose_config):
    cfg = compose_config("num_envs=2", "+env.transforms.push.impulze=3")
    with pytest.raises(
        Exception, match=r"transforms\.push\.impulze is not .*; did you mean impulse"
    ):
        instantiate(cfg.env)


def test_config_survives_a_round_trip_through_text(compose_config):
    """What a checkpoint stores builds the same env."""
    cfg = compose_config("num_envs=2")
    text = OmegaConf.to_yaml(cfg, resolve=True)
    names = [
        [type(t).__name__ for t in instantiate(c.env).transform]
        for c in (cfg, OmegaConf.create(text))
    ]
    assert names[0] == names[1]


def test_a_transform_stands_before_the_one_it_names(make_base):
    late = {"_target_": "zfall.envs.transforms.windows.LastAction", "before": "vector"}
    vector = {
        "_target_": "zfall.envs.transforms.observations.ObservationVector",
        "out_key": "observation",
        "measured": True,
        "keys": ["joint_position"],
    }
    env = make_env(make_base(), table(vector=vector, late=late))
    names = [type(t).__name__ for t in env.transform]
    assert names.index("LastAction") == names.index("ObservationVector") - 1
    with pytest.raises(ValueError, match=r"late.before must name another transform .*got tail"):
        make_env(make_base(), table(vector=vector, late=late | {"before": "tail"}))


def test_sensing_after_the_observation_that_should_hold_it_is_refused(make_base):
    vector = {
        "_target_": "zfall.envs.transforms.observations.ObservationVector",
        "out_key": "observation",
        "measured": True,
        "keys": ["joint_position"],
    }
    noise = {
        "_target_": "zfall.envs.transforms.observations.ObservationNoise",
        "std": {"joint_position": 0.1},
    }
    with pytest.raises(ValueError, match=r"transforms.noise must come before vector, which reads"):
        make_env(make_base(), table(vector=vector, noise=noise))
    make_env(make_base(), table(vector=vector, noise=noise | {"before": "vector"}))


class AddsInPlace(Transform):
    """Adds 1 to what the base env gave, in its own memory, as a user's transform may."""

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict["joint_position"] += 1.0
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)


@pytest.mark.parametrize("changed", [False, True])
def test_a_partial_reset_keeps_the_rows_of_other_worlds(make_base, changed):
    """Also what a transform writes in place, and what a caller has put in place of a key."""
    base = make_base(num_envs=4)
    in_place = {"add": AddsInPlace()} if changed else {}
    env = make_env(base, {"action": JointPositionTarget(base, scale=0.6), **in_place})
    td = env.reset()
    for _ in range(3):
        td["action"] = torch.randn(4, 20)
        td = env.step_mdp(env.step(td))
    if changed:
        td["com_position"] = td["com_position"] + 5.0
    before = td.clone()
    after = env.reset(td.set("_reset", torch.tensor([[True], [False], [True], [False]])))
    for key in ("joint_position", "com_position", "feet_force"):
        assert torch.equal(after[key][1::2], before[key][1::2]), key
    start = base.stand_position + float(changed)
    assert_close(after["joint_position"][::2], start.expand(2, -1))
    assert (after["com_position"][::2, 2] < 0.3).all()


@pytest.mark.parametrize(("reader", "values", "noisy"), [
    ("estimation.NumericalVelocity", {}, "joint_position"),
    ("estimation.JointVelocityKalmanFilter", {}, "joint_position"),
    ("estimation.TiltKalmanFilter", {}, "base_angular_velocity"),
    ("observations.TiltAngles", {}, "projected_gravity"),
])  # fmt: skip
def test_sensing_after_an_estimator_that_should_see_it_is_refused(make_base, reader, values, noisy):
    def of(place: str, **more: object) -> dict[str, object]:
        return {"_target_": f"zfall.envs.transforms.{place}"} | more

    noise = of("observations.ObservationNoise", std={noisy: 0.1})
    with pytest.raises(ValueError, match=f"noise must come before reader, which reads {noisy}"):
        make_env(make_base(), table(reader=of(reader, **values), noise=noise))
    make_env(make_base(), table(noise=noise, reader=of(reader, **values)))


def test_a_key_that_is_written_but_not_declared_is_refused(make_base):
    class Undeclared(Transform):
        def __init__(self) -> None:
            super().__init__(in_keys=["joint_position"], out_keys=["first_joint"])

        def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
            return next_tensordict.set("first_joint", next_tensordict["joint_position"][:, :1])

    base = make_base()
    table = {"action": JointPositionTarget(base, scale=0.6), "first": Undeclared()}
    with pytest.raises(ValueError, match=r"^transforms.first must declare the key 'first_joint'"):
        make_env(base, table)
