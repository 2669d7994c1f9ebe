"""What the servos are commanded in a step, and whether the step can be taken."""

import torch
from tensordict import TensorDictBase
from torch import Tensor


def read_control(tensordict: TensorDictBase, shape: tuple[int, int, int]) -> tuple[Tensor, Tensor]:
    """Targets of the servos in each physics step, and worlds that cannot go on.

    Args:
        tensordict: of the step: ``control`` ``(N, S, J)``, or ``target`` ``(N, J)`` for all
            physics steps [rad]; and ``fault`` ``(N, 1)`` bool, if there is one.
        shape: ``(N, S, J)``.

    Returns:
        The targets ``(N, S, J)``, 0 where they are not finite; and the worlds ``(N,)`` bool with a
        fault or such a target.

    Raises:
        ValueError: if neither is there, or it has another shape.
    """
    worlds, substeps, joints = shape
    control = tensordict.get("control", None)
    if control is None:
        target = tensordict.get("target", None)
        if target is None:
            raise ValueError(
                "the env must be given target or control, as JointPositionTarget makes one of "
                f"them from an action; got {', '.join(map(str, tensordict.keys()))}."
            )
        check_shape("target", target, (worlds, joints))
        control = target[:, None].expand(-1, substeps, -1)
    check_shape("control", control, shape)
    fault = tensordict.get("fault", None)
    failed = torch.zeros(worlds, dtype=torch.bool) if fault is None else fault.reshape(worlds)
    finite = control.isfinite()
    if not finite.all():
        failed = failed | ~finite.flatten(1).all(-1)
        control = torch.where(finite, control, 0.0)
    return control, failed


def check_shape(key: str, value: Tensor, shape: tuple[int, ...]) -> None:
    """Refuses a value that torch would spread over worlds, steps or axes without a word."""
    if value.shape != shape:
        raise ValueError(f"{key} must have the shape {shape}, got {tuple(value.shape)}.")


class Repeats:
    """Notices a step that is taken from what was there before the step that preceded it.

    ``FrameSkipTransform`` steps an env again and again from one TensorDict. What a transform reads
    from there is old then, and a push acts in each of these steps.
    """

    def __init__(self) -> None:
        self._before: Tensor | None = None

    def forget(self) -> None:
        """After a reset or a restored state any TensorDict may follow."""
        self._before = None

    def check(self, tensordict: TensorDictBase, now: Tensor | None) -> None:
        """To be called before each step.

        Args:
            tensordict: of the step. One with ``next`` has been stepped from by hand before.
            now: the last ``base_position`` that was observed ``(N, 3)``.

        Raises:
            ValueError: if the TensorDict has the one before the last step.
        """
        old, given = self._before, tensordict.get("base_position", None)
        self._before = now
        if old is None or given is None or now is None or given is now:
            return
        if torch.equal(given, old) and not torch.equal(given, now) and "next" not in tensordict:
            raise ValueError(
                "a step must begin where the last one ended, got the TensorDict from before it. "
                "In place of FrameSkipTransform give base_env a longer control_dt; in a loop go on "
                "with step_mdp(td)."
            )
