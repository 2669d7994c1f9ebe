"""What motion costs."""

from tensordict import TensorDictBase
from torch import Tensor


def action_rate(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """Squared change of the action from one step to the next, summed over joints.

    Reads ``action`` and ``last_action`` ``(*B, J)`` before the step, without unit.
    Returns ``(*B, 1)``, at least 0.
    """
    return (td["action"] - td["last_action"]).square().sum(-1, keepdim=True)


def joint_torque(td: TensorDictBase, next_td: TensorDictBase) -> Tensor:
    """Sum over joints of the squared mean torque of the step [N2 m2].

    Reads ``joint_torque`` ``(*B, J)`` [N m]. Returns ``(*B, 1)``, at least 0.
    """
    return next_td["joint_torque"].square().sum(-1, keepdim=True)
