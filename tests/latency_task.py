"""A task for a memory, in the physics: be at announced angles on time, by servos that are late.

The robot stands and swings its arms between two angles. It is told 0.24 s ahead when to change.
How late its commands arrive is drawn once an episode and never said: the arms show it, while they
move. To be on time the policy has to remember it.
"""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import CatTensors, InitTracker, RewardSum, StepCounter, Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env as make_table
from zfall.envs.table_env import TableEnv
from zfall.envs.transforms.actions import ActuatorDelay
from zfall.envs.transforms.rewards import WeightedReward
from zfall.envs.transforms.values import reset_rows

DT, LATEST = 0.04, 0.20  # of a control step, and of the commands [s]
AHEAD = 7  # announced angles: of the end of this step, and of the six after it
SWING = 0.3  # to either side of the standing pose [rad]
STEPS = 75  # of an episode
ARMS = ("right_shoulder_pitch", "left_shoulder_pitch")


class Arms(Transform):
    """The action ``(N, 1)`` [0.3 rad] is the target of both arms; the others stand."""

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys_inv=["target"], out_keys_inv=["action"])
        self.stand = env.stand_position
        self.arms = [env.robot.joints.index(name) for name in ARMS]

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = tensordict["action"].clamp(-3.0, 3.0)
        target = self.stand.repeat(len(action), 1)
        target[:, self.arms] += SWING * action
        return tensordict.set("target", target)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._reset(next_tensordict, next_tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        moved = (tensordict_reset["joint_position"] - self.stand)[:, self.arms] / SWING
        return tensordict_reset.set("arms", moved.mean(-1, keepdim=True))

    def transform_input_spec(self, input_spec: Composite) -> Composite:
        actions = input_spec["full_action_spec"]
        shape = (actions.pop("control").shape[0], 1)
        actions["action"] = Bounded(-3.0, 3.0, shape=shape)
        return input_spec

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["arms"] = Unbounded((*observation_spec.shape, 1))
        return observation_spec


class Announced(Transform):
    """Angles to be at, -1 or 1, ``announced`` ``(N, 7)``: they change every 0.2 to 0.6 s."""

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys=[], out_keys=["announced"])
        self.coming = torch.ones(env.num_envs, AHEAD)
        self.rest = torch.zeros(env.num_envs)

    def _next(self) -> Tensor:
        self.rest = self.rest - 1.0
        change = self.rest <= 0.0
        self.rest = torch.where(change, torch.randint(5, 16, self.rest.shape).float(), self.rest)
        return torch.where(change, -1.0, 1.0) * self.coming[:, -1]

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        self.coming = torch.cat([self.coming[:, 1:], self._next()[:, None]], -1)
        return next_tensordict.set("announced", self.coming.clone())

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        drawn = 2.0 * torch.randint(2, (len(rows), 1)).float() - 1.0
        self.coming = torch.where(rows[:, None], drawn.expand(-1, AHEAD), self.coming)
        return tensordict_reset.set("announced", self.coming.clone())

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        observation_spec["announced"] = Unbounded((*observation_spec.shape, AHEAD))
        return observation_spec


def late(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """Squared distance of the arms from where they were announced to be ``(N, 1)`` [0.3 rad]."""
    return (next_td["arms"] - td["announced"][:, :1]).square()


class Forgetful(InitTracker):
    """Says in every step that an episode begins: a network's memory is put back to 0."""

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        super()._step(tensordict, next_tensordict)
        return next_tensordict.set("is_init", torch.ones_like(next_tensordict["is_init"]))


def make_env(num_envs: int, memory: bool = True) -> TableEnv:
    """The task with what learning reads."""
    env = HumanoidEnv(num_envs=num_envs, control_dt=DT, physics_dt=0.004)
    lag = {"delay": [0.0, LATEST], "max_delay": LATEST, "param": "command_latency"}
    sees = ["arms", "announced"]
    transforms = {
        "arms": Arms(env),
        "late": ActuatorDelay(env, **lag),
        "announced": Announced(env),
        "reward": WeightedReward(env, terms={"late": (-1.0, late)}),
        "limit": StepCounter(STEPS),
        "observation": CatTensors(sees, "observation", del_keys=False),
        "observation_critic": CatTensors(
            [*sees, ("params", "command_latency")], "observation_critic", del_keys=False
        ),
        "init": InitTracker() if memory else Forgetful(),
        "episode": RewardSum(),
    }
    return make_table(env, transforms)
