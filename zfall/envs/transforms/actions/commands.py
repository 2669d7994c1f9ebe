"""What the servos are commanded at each physics step, and the order in which it is made."""

from collections.abc import Iterable

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, FrameSkipTransform, MultiAction, NoopResetEnv, Transform

from zfall.envs.transforms.base_env import base_env_of

COMMANDS = ("target", "control")
STEP_COPIES = (FrameSkipTransform, MultiAction, NoopResetEnv)
IN_A_COMPOSE = (
    "; a Compose runs these from its last to its first, so what acts on commands stands before "
    "what makes them: Compose(ActuatorDelay, JointPositionTarget), env.insert_transform(0, ...)."
)


def read_commands(transform: Transform, tensordict: TensorDictBase, substeps: int) -> Tensor:
    """Commands of the coming S physics steps ``(N, S, J)`` [rad].

    ``control`` if an earlier transform wrote it, else ``target`` ``(N, J)``, in all steps. A
    transform outside of its env is refused.
    """
    base_env_of(transform)
    control = tensordict.get("control", None)
    if control is None:
        control = tensordict["target"][:, None].expand(-1, substeps, -1)
    return control


def targets_before(tensordict: TensorDictBase, otherwise: Tensor) -> Tensor:
    """What the servos followed until an episode begins ``(N, J)`` [rad].

    ``("start", "target")``, if a start has written it, where it is not NaN; else ``otherwise``
    ``(N, J)``. Reads the first argument of a transform's ``_reset``.
    """
    given = tensordict.get(("start", "target"), None)
    return otherwise if given is None else torch.where(given.isnan(), otherwise, given)


def refuse_commands(transform: Transform, tensordict: TensorDictBase) -> None:
    """For the transform that makes the commands of a step: refuses that there are some already.

    What acts on commands before they are made has acted on those of the step before: every command
    is then late by a control step.

    Raises:
        ValueError: if ``control`` is there.
    """
    if "control" in tensordict.keys():
        raise ValueError(
            f"{type(transform).__name__} must act before all that writes control, got control "
            f"already written{IN_A_COMPOSE}"
        )


def check_chain(transform: Transform) -> None:
    """``check_order`` of all transforms in the env that a transform is part of, if there is one.

    Also refuses those of TorchRL that step the env themselves, which they do with copies of the
    others, each with a memory of its own: pushes would come twice, and commands late.
    """
    env = transform.container
    if env is not None:
        for other in flattened(env.transform):
            if isinstance(other, STEP_COPIES):
                raise ValueError(
                    f"{type(other).__name__} must not be among the transforms of a task, which it "
                    "steps in copies: give base_env a longer control_dt, or MultiAction to a "
                    "TransformedEnv around the env that make_env builds."
                )
        chain = [(type(t).__name__, t) for t in reversed(flattened(env.transform))]
        check_order(chain, IN_A_COMPOSE)


def check_order(chain: Iterable[tuple[str, Transform]], hint: str = ".") -> None:
    """Refuses orders in which a transform reads commands of the step before, or changes none.

    Which of them read and write commands is what ``out_keys_inv`` and ``in_keys_inv`` say.

    Args:
        chain: names and transforms, in the order in which they act.
        hint: end of a message.

    Raises:
        ValueError: if one acts on ``target`` or ``control`` before the one that makes it of the
            action; on ``action`` after that, or on ``target`` after another has turned it into
            ``control``; or if two make it.
    """
    read: dict[str, str] = {}  # the first that reads or writes a key
    maker = ""
    for name, transform in chain:
        if not transform.in_keys_inv:  # works on the way back
            continue
        reads = [key for key in COMMANDS if key in transform.out_keys_inv]
        writes = [key for key in COMMANDS if key in transform.in_keys_inv]
        if writes and not reads:
            if maker:
                raise ValueError(
                    f"{name} must be the only one that makes {writes[0]}, got {maker}."
                )
            if read:
                early = next(iter(read.values()))
                raise ValueError(
                    f"{early} must act after {name}, which makes the commands that it reads, got "
                    f"it before: they would be those of the last step{hint}"
                )
            maker = name
        late = maker if "action" in transform.in_keys_inv else ""
        late = late or (read.get("control", "") if writes == ["target"] else "")
        if late:
            raise ValueError(
                f"{name} must act before {late}, which reads what it changes, got it after: it "
                f"would have no effect{hint}"
            )
        for key in (*reads, *writes):
            read.setdefault(key, name)


def flattened(transform: Transform) -> list[Transform]:
    """A transform, or those of a ``Compose``, nested ones included, in its order."""
    if isinstance(transform, Compose):
        return [one for inner in transform for one in flattened(inner)]
    return [transform]
