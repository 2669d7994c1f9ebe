"""What is written down about a batch."""

from tensordict import TensorDictBase

from zfall.training.ranks import ALONE, Ranks


def batch_metrics(
    batch: TensorDictBase, carrier: TensorDictBase, control_dt: float, ranks: Ranks = ALONE
) -> dict[str, float]:
    """Means over a batch, by the names of ``metrics.csv``.

    Args:
        batch: of an update.
        carrier: what the worlds are in after it: physical parameters, level of the curriculum.
        control_dt: time between two actions [s].
        ranks: each of which has a part of the worlds.
    """
    after = batch["next"]
    ended = after["done"]
    episodes, rows, worlds = int(ended.sum()), float(ended.numel()), float(len(ended))
    metrics: dict[str, tuple[float, float | None]] = {
        "reward": (after["reward"].mean().item(), rows),
        "episodes": (episodes, None),
        "terminated": (int(after["terminated"].sum()), None),
    }
    if "diverged" in after.keys():  # of physics alone
        metrics["diverged"] = int(after["diverged"].sum()), None
    # Without an episode that ended the columns keep the last value known.
    metrics["episode_return"] = after["episode_reward"][ended].mean().item(), episodes
    if "step_count" in after.keys():
        steps = after["step_count"][ended].float()
        metrics["episode_seconds"] = steps.mean().item() * control_dt, episodes
    # A task may have neither, or its own transforms in their place.
    for key, term in after.get("reward_terms", {}).items():
        metrics[f"reward/{key}"] = term.mean().item(), rows
    for key, ends in after.get("terminations", {}).items():
        metrics[f"termination/{key}"] = int(ends.sum()), None
    if "curriculum_level" in carrier.keys():
        metrics["curriculum/level"] = carrier["curriculum_level"].mean().item(), worlds
    for key, value in carrier.get("params", {}).items():
        metrics[f"params/{key}"] = value.mean().item(), worlds
    return ranks.means(metrics)
