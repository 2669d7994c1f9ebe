"""What comes of the worlds of a film, and what is written on its pictures of it."""

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms.falls import body_contact
from zfall.evaluation.followers import Ended, Follower, Moment
from zfall.evaluation.video import Outcomes


class Endings:
    """Follows step by step how the worlds end.

    A world is down as soon as a region but the feet touches the floor. Whether that was meant is
    for the outcomes of the followers to say, those of a battery's ``measures``.

    Args:
        env: the base env.
        followers: classes of ``followers_of``; those without outcomes are left out.

    Attributes:
        fell: worlds that are or were down ``(N,)`` bool.
        fall_time: when they first were ``(N,)`` [s]; NaN of others.
        end_time: when the task ended otherwise, before any fall ``(N,)`` [s]; NaN of others.
        up: worlds that neither fell nor ended ``(N,)`` bool.
        reached: by the name of an outcome, for which worlds it is true now ``(N,)`` bool.
    """

    def __init__(self, env: HumanoidEnv, followers: Sequence[type[Follower]] = ()):
        n = env.num_envs
        self.fell = torch.zeros(n, dtype=torch.bool)
        self.up = ~self.fell
        self.fall_time, self.end_time = torch.full((2, n), torch.nan)
        self._followers = [each(env) for each in followers if each.outcomes]
        names = [name for each in self._followers for name in each.outcomes]
        self.reached = {name: torch.zeros(n, dtype=torch.bool) for name in names}
        self._changes: list[tuple[float, str, Tensor, Tensor]] = []  # who changed, who has it then

    def update(self, td: TensorDictBase, time: float) -> None:
        """Takes in what followed the control step that ended at ``time`` [s]."""
        down = body_contact(td, td)[:, 0]
        first = down & ~self.fell
        self.fall_time[first] = time
        now = Moment(time, torch.ones_like(down), down, first, ~self.fell)
        self.fell = self.fell | down
        ended = self.up & ~self.fell & td["terminated"][:, 0]
        self.end_time[ended] = time
        self.up = self.up & ~ended & ~self.fell
        failed = Ended(self.fell, td["diverged"][:, 0], torch.zeros_like(down))
        for follower in self._followers:
            follower.update(td, now)
            table = follower.table(failed)
            for name in follower.outcomes:
                changed = table[name] != self.reached[name]
                if changed.any():
                    self._changes.append((time, name, changed, table[name]))
                self.reached[name] = table[name]

    def said(self, world: int, end: float, *, task: bool = True) -> Outcomes:
        """What a film says of a world, and from when on.

        Args:
            world: its number.
            end: of the film [s].
            task: whether it matters that the task ended it before it fell.
        """
        changes = [
            (time, f"{name if has[world] else 'fell'} {{when}}", bool(has[world]))
            for time, name, changed, has in self._changes
            if changed[world]
        ]
        fall_time = float(self.fall_time[world])
        ended = float(self.end_time[world]) if task else math.nan
        return changes or said(fall_time, end, ended=ended)


def said(fall_time: float, end: float, *, ended: float = math.nan) -> Outcomes:
    """What a film says of a world, and from when on.

    Args:
        fall_time: when it fell [s], NaN if it did not.
        end: of the film [s].
        ended: when the task ended it otherwise, before any fall [s]; NaN if it did not.
    """
    if not math.isnan(ended):
        return [(ended, "task ended {when}", False)]
    if math.isnan(fall_time):
        return [(max(0.0, end - 1.5), "stays up", True)]
    return [(fall_time, "fell {when}", False)]
