"""Begins a training with the weights of a policy that was trained before."""

from pathlib import Path

from omegaconf import OmegaConf

from zfall import checkpoint
from zfall.envs.tables import check_same_interface
from zfall.policies.load import checkpoint_of
from zfall.simulation.model import identity_of
from zfall.training.learner import Learner

# Which no weight tells of, and what is meant without them.
UNTOLD = {"activation": "elu", "statistic": "mean", "handedness": None}


def warm_start(learner: Learner, run: str | Path, *, keep_deviation: bool = False) -> None:
    """Gives the actor, and the critic if it sees the same and is configured alike, a run's weights.

    The deviation of a plain Gaussian that does not depend on the state stays as configured, so
    that the policy explores anew, unless it is kept. Any other deviation goes on; that of
    a mixture with a lower floor is by as much less, below its cap. Another ``control_dt`` is
    taken: the policy goes on with more or fewer decisions.

    Args:
        learner: before its first update.
        run: a run folder, the name of a policy that ships, or the file of a checkpoint.
        keep_deviation: whether that deviation, too, is the run's.

    Raises:
        ValueError: if there is no such run, or its policy sees or does something else.
    """
    path = run if isinstance(run, Path) else checkpoint_of(run, key="warm_start")
    content = checkpoint.load(path)
    theirs = OmegaConf.create(content["config"])
    check_same_interface({str(run): theirs, "this run": learner.cfg}, rate=False)
    robot = identity_of(learner.env.base_env.robot)
    checkpoint.check_fits(content, robot, learner.actor, path)
    for key, otherwise in UNTOLD.items():
        one, other = (cfg.actor.get(key, otherwise) for cfg in (theirs, learner.cfg))
        if one != other:
            raise ValueError(
                f"{run} and this run must have the same actor.{key}, got {one} and {other}."
            )
    state_std = any("deviation" in key for key in content["policy"])
    own = () if state_std or keep_deviation else ("log_std",)
    weights = {k: v for k, v in content["policy"].items() if not k.endswith(own)}
    with checkpoint.reading(path):
        for module in (learner.actor, learner.policy):
            module.load_state_dict(weights, strict=False)
    seen = [cfg.env.transforms.get("observation_critic") for cfg in (theirs, learner.cfg)]
    if "critic" in content and seen[0] == seen[1] and theirs.critic == learner.cfg.critic:
        with checkpoint.reading(path):
            learner.critic.load_state_dict(content["critic"])
