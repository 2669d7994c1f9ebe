"""What is written down about a batch."""

from tensordict import TensorDictBase


def batch_metrics(
    batch: TensorDictBase, carrier: TensorDictBase, control_dt: float
) -> dict[str, float]:
    """Means over a batch, by the names of ``metrics.csv``.

    Args:
        batch: of an update.
        carrier: what the worlds are in after it: physical parameters, level of the curriculum.
        control_dt: time between two actions [s].
    """
    after = batch["next"]
    ended = after["done"]
    metrics = {
        "reward": after["reward"].mean().item(),
        "episodes": int(ended.sum()),
        "terminated": int(after["terminated"].sum()),
    }
    if "diverged" in after.keys():  # of physics alone
        metrics["diverged"] = int(after["diverged"].sum())
    if ended.any():  # else the columns keep the last value known
        metrics["episode_return"] = after["episode_reward"][ended].mean().item()
        if "step_count" in after.keys():
            steps = after["step_count"][ended].float()
            metrics["episode_seconds"] = steps.mean().item() * control_dt
    # A task may have neither, or its own transforms in their place.
    metrics |= {f"reward/{k}": v.mean().item() for k, v in after.get("reward_terms", {}).items()}
    metrics |= {f"termination/{k}": int(v.sum()) for k, v in after.get("terminations", {}).items()}
    if "curriculum_level" in carrier.keys():
        metrics["curriculum/level"] = carrier["curriculum_level"].mean().item()
    metrics |= {f"params/{k}": v.mean().item() for k, v in carrier.get("params", {}).items()}
    return metrics
