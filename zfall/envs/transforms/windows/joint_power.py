"""What the joints put out."""

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, check_recorded, needs_env


class JointPower(Transform):
    """Adds up the mechanical power of all joints, mean over the physics steps of a control step.

    ``sum_j (torque_j - damping_j v'_j - friction_j sign(m_j)) m_j`` with v' the velocity after a
    physics step and m the mean of those before and after it: what is left of the servos' torque
    for moving the links, negative where the joints brake. A servo's own torque times velocity
    would count what its motor and gears lose as well; the published limit is one on a robot
    whose drives lose little. Dry friction is taken at its full size, which a joint at rest does
    not reach, with no power all the same.

    The physics holds a torque for a step and lets the damping act at its end: taken so, power x
    time is the kinetic energy that the step brings. The velocity at the end in place of the mean
    would be off by 4 W for a leg's largest torque and a step of 5 ms.

    Keys: reads ``("substeps", "joint_torque")`` [N m] and ``("substeps", "joint_velocity")``
    [rad/s] ``(N, S, J)``, and ``joint_velocity`` ``(N, J)`` from before the step; writes
    ``power`` ``(N, 1)`` [W], 0 after a reset.

    Args:
        env: the base env, which is made to record torques and velocities. Its ``joint_damping``
            and ``joint_friction_loss`` of each world count.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV-C.6.
    """

    damping: Tensor
    friction: Tensor

    def __init__(self, env: HumanoidEnv):
        super().__init__(
            in_keys=[("substeps", "joint_torque"), ("substeps", "joint_velocity")],
            out_keys=["power"],
        )
        needs_env(self, env, "physics steps that it records")
        env.record_substeps(["joint_torque", "joint_velocity"])
        model = env.simulation.model
        dofs = [int(model.joint(name).dofadr[0]) for name in env.robot.joints]
        self.register_buffer("damping", torch.tensor(model.dof_damping[dofs]).float())
        self.register_buffer("friction", torch.tensor(model.dof_frictionloss[dofs]).float())

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        torque, velocity = (next_tensordict[key] for key in self.in_keys)
        before = torch.cat([tensordict["joint_velocity"][:, None], velocity[:, :-1]], 1)
        mean = (before + velocity) / 2.0
        factors = base_env_of(self).parameters.values
        damping = (self.damping * factors["joint_damping"])[:, None]
        friction = (self.friction * factors["joint_friction_loss"])[:, None]
        power = (torque - damping * velocity) * mean - friction * mean.abs()
        return next_tensordict.set(self.out_keys[0], power.sum(-1).mean(-1, keepdim=True))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        base_env_of(self)
        power = tensordict_reset["joint_torque"].new_zeros(*tensordict_reset.shape, 1)
        return tensordict_reset.set(self.out_keys[0], power)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        check_recorded(self, observation_spec, ["joint_torque", "joint_velocity"])
        observation_spec[self.out_keys[0]] = Unbounded((*observation_spec.shape, 1))
        return observation_spec
