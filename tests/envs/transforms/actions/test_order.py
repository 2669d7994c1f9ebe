"""Commands act in the step that they are meant for, however an env is put together."""

import pytest
import torch
from tensordict import TensorDictBase
from torchrl.envs import ActionScaling, Compose, SerialEnv, Transform, TransformedEnv
from torchrl.envs.utils import check_env_specs

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.transforms.actions import (
    ActuatorDelay,
    JointPositionTarget,
    JointVelocityTarget,
    LowPass,
)
from zfall.falling.modes import ModeMachine, StableHold

CONTROL_DT, DELAY = 0.02, 0.04  # [s]


def build_base() -> HumanoidEnv:
    return HumanoidEnv(num_envs=2, control_dt=CONTROL_DT)


@pytest.fixture(scope="module")
def base() -> HumanoidEnv:
    return build_base()


def action_of(base: HumanoidEnv) -> JointPositionTarget:
    return JointPositionTarget(base, scale=0.6)


def delay_of(base: HumanoidEnv) -> ActuatorDelay:
    return ActuatorDelay(base, delay=(DELAY, DELAY))


def nested(base: HumanoidEnv, *transforms: Transform) -> TransformedEnv:
    """An env in an env, the first transform next to the physics."""
    env = base
    for transform in transforms:
        env = TransformedEnv(env, transform, auto_unwrap=False)
    return env


RIGHT = {
    "compose": lambda b: TransformedEnv(b, Compose(delay_of(b), action_of(b))),
    "nested compose": lambda b: TransformedEnv(
        b, Compose(Compose(delay_of(b)), Compose(Compose(action_of(b))))
    ),
    "append": lambda b: TransformedEnv(b, delay_of(b)).append_transform(action_of(b)),
    "insert": lambda b: TransformedEnv(b, action_of(b)).insert_transform(0, delay_of(b)),
    "unwrapped": lambda b: TransformedEnv(TransformedEnv(b, delay_of(b)), action_of(b)),
    "env in env": lambda b: nested(b, delay_of(b), action_of(b)),
    "clone": lambda b: TransformedEnv(b, Compose(delay_of(b), action_of(b)).clone()),
    "serial": lambda b: SerialEnv(2, lambda: with_base(delay_of, action_of)),
    "around serial": lambda b: TransformedEnv(
        SerialEnv(2, lambda: with_base(delay_of)), action_of(b)
    ),
    "make_env": lambda b: table(action_of, delay_of)(b),
    "made and unwrapped": lambda b: TransformedEnv(table(delay_of)(b), action_of(b)),
}


def with_base(*makers) -> TransformedEnv:
    """An env of its own, as a worker builds it."""
    base = build_base()
    return TransformedEnv(base, Compose(*(make(base) for make in makers)))


def table(*makers):
    return lambda b: make_env(b, {maker.__name__: maker(b) for maker in makers})


def appended_later(base: HumanoidEnv) -> TransformedEnv:
    env = TransformedEnv(base, Compose(action_of(base)))
    check_env_specs(env)  # specs are made and kept
    env.transform.append(delay_of(base))
    return env


WRONG = {
    "compose": lambda b: TransformedEnv(b, Compose(action_of(b), delay_of(b))),
    "nested compose": lambda b: TransformedEnv(
        b, Compose(Compose(action_of(b)), Compose(Compose(delay_of(b))))
    ),
    "append": lambda b: TransformedEnv(b, action_of(b)).append_transform(delay_of(b)),
    "appended to a Compose in use": appended_later,
    "append to a table": lambda b: table(action_of)(b).append_transform(delay_of(b)),
    "insert": lambda b: TransformedEnv(b, delay_of(b)).insert_transform(0, action_of(b)),
    "unwrapped": lambda b: TransformedEnv(TransformedEnv(b, action_of(b)), delay_of(b)),
    "env in env": lambda b: nested(b, action_of(b), delay_of(b)),
    "clone": lambda b: TransformedEnv(b, Compose(action_of(b), delay_of(b)).clone()),
    "serial": lambda b: SerialEnv(2, lambda: with_base(action_of, delay_of)),
    "make_env": lambda b: table(delay_of, action_of)(b),
    "made and unwrapped": lambda b: TransformedEnv(table(action_of)(b), delay_of(b)),
}


def latency(env) -> float:
    """Time from a command that differs to a joint that moves differently [s]."""
    runs = []
    for size in (0.0, 0.3):
        td, seen = env.reset(), []
        for step in range(6):
            td["action"] = env.action_spec.zero() + size * (step == 1)
            td = env.step(td)["next"]
            seen.append(td["joint_velocity"].flatten())
        runs.append(torch.stack(seen))
    return (int((runs[0] != runs[1]).any(-1).nonzero()[0]) - 1) * CONTROL_DT


@pytest.mark.filterwarnings("ignore:Nested TransformedEnvs")
@pytest.mark.parametrize("way", RIGHT)
def test_a_delay_is_what_was_given_however_the_env_is_put_together(base, way):
    assert latency(RIGHT[way](base)) == pytest.approx(DELAY)


@pytest.mark.filterwarnings("ignore:Nested TransformedEnvs")
@pytest.mark.parametrize("way", WRONG)
def test_a_delay_that_would_act_on_the_last_steps_command_is_refused(base, way):
    with pytest.raises(ValueError, match=r"must act (after|before) .*got (it before|control)"):
        latency(WRONG[way](base))


class Doubled(Transform):
    """A user's own, between policy and physics."""

    def __init__(self, key: str):
        super().__init__(in_keys_inv=[key], out_keys_inv=[key])

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        (key,) = self.in_keys_inv
        return tensordict.set(key, 2 * tensordict[key])


@pytest.mark.parametrize(("order", "message"), [
    ((lambda b: Doubled("target"), action_of), r"transforms.0 must act after transforms.1"),
    ((action_of, delay_of, lambda b: Doubled("target")), r"transforms.2 .* before transforms.1"),
    ((action_of, lambda b: Doubled("action")), r"transforms.1 must act before transforms.0"),
    ((action_of, lambda b: ActionScaling(loc=0.0, scale=1.0)), "transforms.1 must act before"),
    ((lambda b: JointVelocityTarget(b, limit=3.0), lambda b: Doubled("target")), "no effect"),
    ((action_of, lambda b: JointVelocityTarget(b, limit=3.0)), "only one that makes target"),
    ((StableHold, action_of, ModeMachine), r"transforms.0 must act after transforms.1"),
    ((lambda b: LowPass(b, time_constant=0.1), action_of), r"got it before"),
])  # fmt: skip
def test_a_table_refuses_what_would_act_too_early_or_too_late(base, order, message):
    with pytest.raises(ValueError, match=message):
        make_env(base, {str(number): make(base) for number, make in enumerate(order)})


def test_a_transform_of_the_users_may_stand_where_it_has_an_effect(base):
    order = (Doubled("action"), action_of(base), Doubled("target"), delay_of(base))
    env = make_env(base, {str(number): transform for number, transform in enumerate(order)})
    check_env_specs(env)
