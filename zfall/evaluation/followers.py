"""What follows the trials of a battery: classes that its yaml names under ``measures``."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.errors import object_at

if TYPE_CHECKING:
    from zfall.evaluation.definitions import Battery


@dataclass(frozen=True)
class Moment:
    """Where the trials of N worlds are after a control step.

    Attributes:
        since_push: time since the push began; negative before it [s].
        counted: trials that go on ``(N,)`` bool: what follows a settled one counts for nothing.
        touched: worlds in which something but the feet touches the floor now ``(N,)`` bool.
        first: those of them in which nothing had touched before ``(N,)`` bool.
        upto_fall: of ``counted``, those that had not fallen before this step ``(N,)`` bool.
    """

    since_push: float
    counted: Tensor
    touched: Tensor
    first: Tensor
    upto_fall: Tensor


@dataclass(frozen=True)
class Ended:
    """How N trials ended.

    Attributes:
        fell: something but the feet touched, or the physics failed ``(N,)`` bool.
        diverged: the physics failed ``(N,)`` bool.
        before_push: they were over before the push ``(N,)`` bool.
    """

    fell: Tensor
    diverged: Tensor
    before_push: Tensor


class Follower(Protocol):
    """Adds columns to ``trials.csv``; made for each chunk of trials as ``Follower(env)``.

    It may also have a static method ``summary(trials)``, which takes the finished trials with all
    columns and returns what ``summary.json`` says of its own; a data frame among that is also
    written as a table of its name, which the report shows. And a static method
    ``figures(trials, folder, title)``, which draws into a folder and returns the files' names. And
    a static method ``remarks(td)``: words by what is true of which worlds ``(N,)`` bool after a
    control step; a film of a trial says them from when on they first are.

    Attributes:
        outcomes: which of its columns are outcomes, true or false: they stand next to
            ``recovered`` and ``fell``, and say in one word how a trial ended.
    """

    outcomes: ClassVar[tuple[str, ...]]

    def __init__(self, env: HumanoidEnv): ...

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step before the push."""

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step after the push began."""

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Its columns ``(N,)``."""


def followers_of(battery: "Battery") -> list[type[Follower]]:
    """The classes that a battery's ``measures`` name.

    Raises:
        ValueError: if a path leads nowhere.
    """
    return [object_at(path, "battery.measures") for path in battery.measures]


def outcome_names(battery: "Battery") -> list[str]:
    """Columns that say how a trial ended, the first true one the word for it."""
    own = [name for follower in followers_of(battery) for name in follower.outcomes]
    return ["recovered", *own, "fell"]
