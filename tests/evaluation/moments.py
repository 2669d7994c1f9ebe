"""Made-up moments of trials, for tests of what follows them."""

from collections.abc import Sequence

import torch

from zfall.evaluation.followers import Ended, Moment


def moment(
    counted: Sequence[bool],
    since_push: float = 0.04,
    *,
    first: Sequence[bool] | None = None,
    touched: Sequence[bool] | None = None,
) -> Moment:
    """A step of trials of which nothing fell before; nothing touches unless said."""
    nothing = [False] * len(counted)
    given = (counted, touched or first or nothing, first or nothing, counted)
    return Moment(since_push, *(torch.tensor(list(flags)) for flags in given))


def ended(fell: Sequence[bool], before_push: Sequence[bool] | None = None) -> Ended:
    """Trials that ended so, the physics sound."""
    nothing = [False] * len(fell)
    given = (fell, nothing, before_push or nothing)
    return Ended(*(torch.tensor(list(flags)) for flags in given))


ENDED = ended([False])
