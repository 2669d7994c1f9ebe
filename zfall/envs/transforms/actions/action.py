"""The action as it comes from the policy: what is read, and within which bounds."""

from tensordict import TensorDictBase
from torch import Tensor, where
from torch import float32 as float32_
from torchrl.data import Bounded, Composite


def read_action(tensordict: TensorDictBase, joints: int) -> Tensor:
    """The action ``(*B, J)`` float32, without gradients: all that follows sees this one.

    Other number types become float32. A row that is not finite counts as 0 and is marked in
    ``fault`` ``(*B, 1)``: the base env ends its world, as if the physics had failed.

    Args:
        tensordict: of the step; ``action`` is replaced in it, where it changes.
        joints: their number J.

    Raises:
        ValueError: on another shape.
    """
    action, shape = tensordict["action"], (*tensordict.batch_size, joints)
    if action.shape != shape:
        raise ValueError(
            f"action must have the shape {shape}, one number for each joint of each world, "
            f"got {tuple(action.shape)}."
        )
    if action.requires_grad or action.dtype != float32_:
        action = action.detach().to(float32_)
        tensordict["action"] = action
    finite = action.isfinite()
    if not finite.all():
        fault = ~finite.all(-1, keepdim=True)
        action = where(fault, 0.0, action)
        tensordict["action"], tensordict["fault"] = action, fault
    return action


def replace_control(input_spec: Composite, low: Tensor, high: Tensor) -> Composite:
    """The specs of an env that takes ``action`` in place of ``control``.

    Args:
        input_spec: of the base env.
        low, high: bounds of the action ``(J,)`` or ``(*B, J)``.
    """
    actions = input_spec["full_action_spec"]
    control = actions.pop("control")
    shape = (*control.shape[:-2], control.shape[-1])
    bounds = (bound.to(float32_).expand(shape).clone() for bound in (low, high))
    actions["action"] = Bounded(*bounds, shape=shape, dtype=float32_)
    return input_spec
