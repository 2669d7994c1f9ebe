"""Training: one ``Learner``, its loop, and the files of a run.

In Python, without hydra::

    from zfall.training import Learner

    learner = Learner({"seed": 1, "num_envs": 64})  # the rest is the quickstart's
    for _ in range(20):
        figures = learner.learn(learner.collect())
        print(learner.frames, figures["kl"])
    learner.policy  # the actor, its weights averaged

``zfall.training.run_training(learner.cfg, folder, console)`` does it with metrics, checkpoints and
resuming.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from zfall.training.learner import Learner
    from zfall.training.loop import run_training

__all__ = ["Learner", "run_training"]

_HOMES = {"Learner": "zfall.training.learner", "run_training": "zfall.training.loop"}


def __getattr__(name: str) -> Any:
    """Loads torch when one of the two is wanted."""
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module zfall.training has no attribute {name}")
