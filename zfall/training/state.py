"""What a training needs to go on, bit for bit."""

from typing import TYPE_CHECKING, Any

import torch
from omegaconf import OmegaConf

from zfall.simulation.model import identity_of

if TYPE_CHECKING:
    from zfall.training.learner import Learner


def state_of(learner: "Learner") -> dict[str, Any]:
    """What a checkpoint holds of a learner; of its worlds, this rank's part."""
    scheduler = learner.scheduler
    return {
        "config": OmegaConf.to_yaml(learner.cfg, resolve=True),
        "robot": identity_of(learner.env.base_env.robot),
        "actor": learner.actor.state_dict(),
        "policy": learner.policy.state_dict(),
        "averaged": int(learner.average.n_averaged),
        "critic": learner.critic.state_dict(),
        "teachers": learner.losses.teachers,
        "optimizer": learner.optimizer.state_dict(),
        "scheduler": scheduler.state_dict() if scheduler else {},
        "buffers": {key: value.clone() for key, value in learner.buffers().items()},
        "worlds": learner.worlds.state_dict(),
        "rng": torch.get_rng_state(),
        **learner.transfers.state_dict(),
        "threads": torch.get_num_threads(),
        "frames": learner.frames,
        "updates": learner.updates,
    }


def restore(learner: "Learner", state: dict[str, Any]) -> list[str]:
    """Goes on from what ``state_of`` gave, see ``Learner.load_state_dict``."""
    for place, known in state.get("teachers", {}).items():
        if learner.losses.teachers.get(place) != known:
            raise ValueError(
                f"{place}.teacher must be what it was when the run began, its weights have "
                "changed: put them back, or begin anew."
            )
    if "redrawn" in state:
        notes = learner.worlds.redraw(state["redrawn"])
    else:
        notes = learner.worlds.load_state_dict(state["worlds"])  # first, as it may refuse
    learner.actor.load_state_dict(state["actor"])
    learner.policy.load_state_dict(state["policy"])
    learner.average.n_averaged.fill_(state["averaged"])
    learner.critic.load_state_dict(state["critic"])
    learner.optimizer.load_state_dict(state["optimizer"])
    if learner.scheduler:
        learner.scheduler.load_state_dict(state["scheduler"])
    for key, value in learner.buffers().items():
        value.copy_(state["buffers"][key])
    torch.set_rng_state(state["rng"])
    learner.transfers.load_state_dict(state)
    # Sums over parts, one for each thread, are rounded in another order with another number.
    if "redrawn" not in state:  # else it goes on with other ranks, and their cores
        torch.set_num_threads(state.get("threads", torch.get_num_threads()))
    learner.frames, learner.updates = state["frames"], state["updates"]
    return notes
