"""What the servos did in the physics steps of a control step."""

from tensordict import TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, check_recorded, needs_env


class JointEffort(Transform):
    """Averages the size of the torques over joints and physics steps.

    ``joint_effort = mean_{s, j} |torque_{s, j}|``: opposite torques do not cancel, neither those of
    two joints nor those of two physics steps, as they do in ``joint_torque``.

    Keys: reads ``("substeps", "joint_torque")`` ``(N, S, J)`` [N m], which it has the env record,
    and writes ``joint_effort`` ``(N, 1)`` [N m].

    Args:
        env: the base env.

    Source: Ferigo et al., "On the emergence of whole-body strategies from humanoid robot
    push-recovery learning", RA-L 2021, section IV-C, which averages the torques themselves.
    """

    def __init__(self, env: HumanoidEnv):
        super().__init__(in_keys=["joint_torque"], out_keys=["joint_effort"])
        needs_env(self, env, "physics steps that it records")
        env.record_substeps(["joint_torque"])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        torque = next_tensordict["substeps", "joint_torque"]
        effort = torque.abs().flatten(1).mean(1, keepdim=True)
        return next_tensordict.set("joint_effort", effort)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        check_recorded(self, observation_spec, ["joint_torque"])
        observation_spec["joint_effort"] = Unbounded((*observation_spec.shape, 1))
        return observation_spec
