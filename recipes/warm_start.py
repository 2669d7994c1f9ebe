"""Begins a training with the weights of a policy that was trained before."""

from omegaconf import OmegaConf

from recipes.learner import Learner
from recipes.tested import check_same_interface, checkpoint_of
from zfall import checkpoint
from zfall.envs.model import identity_of


def warm_start(learner: Learner, run: str) -> None:
    """Gives the actor, and the critic if it sees the same and is of its shape, a run's weights.

    The deviation of a plain Gaussian that does not depend on the state stays as configured, so
    that the policy explores anew.

    Args:
        learner: before its first update.
        run: a run folder, or the name of a policy that ships.

    Raises:
        ValueError: if there is no such run, or its policy sees or does something else.
    """
    path = checkpoint_of(run)
    content = checkpoint.load(path)
    theirs = OmegaConf.create(content["config"])
    check_same_interface({run: theirs, "this run": learner.cfg})
    robot = identity_of(learner.env.base_env.robot)
    checkpoint.check_fits(content, robot, learner.actor, path)
    state_std = any("deviation" in key for key in content["policy"])
    own = () if state_std else ("log_std",)
    weights = {k: v for k, v in content["policy"].items() if not k.endswith(own)}
    for module in (learner.actor, learner.policy):
        module.load_state_dict(weights, strict=False)
    critic = content.get("critic", {})
    mine = learner.critic.state_dict()
    seen = [cfg.env.transforms.get("observation_critic") for cfg in (theirs, learner.cfg)]
    if seen[0] == seen[1] and {k: v.shape for k, v in critic.items()} == {
        k: v.shape for k, v in mine.items()
    }:
        learner.critic.load_state_dict(critic)
