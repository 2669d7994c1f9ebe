"""What ``recipes.evaluate`` was given: checked, as names of policies, as the name of a folder."""

from typing import Any

from omegaconf import DictConfig, OmegaConf

from zfall.evaluation.baselines import baseline_names
from zfall.evaluation.definitions import Battery, table_of
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.run import setting_name


def check_values(cfg: DictConfig, servo: str | None = None) -> None:
    """Refuses values of the recipe itself that make no sense.

    Args:
        cfg: of the recipe.
        servo: the servos chosen; ``None``: those of the training.
    """
    if (cfg.run is None) == (cfg.runs is None):
        raise ValueError(
            f"run must be a run folder, or {' or '.join(baseline_names())}, or runs a list of "
            f"them; got {'none' if cfg.run is None else 'both'}."
        )
    if cfg.video and cfg.trial is None:
        raise ValueError("video needs a trial, by its number in trials.csv: trial=1000.")
    for key, plain in (("slow", 1), ("slow_for", None), ("shown", None)):
        if cfg[key] != plain and not cfg.video:
            raise ValueError(f"{key} needs a film, video=true, got {key}={cfg[key]} without one.")
    if servo is not None and OmegaConf.select(cfg, "battery.world.base_env.servos") is not None:
        raise ValueError(
            f"servo must be left out with a battery whose world has servos of its own, got "
            f"{servo}: servo@battery.world.base_env={servo} gives it others."
        )


def names_of(cfg: DictConfig, battery: Battery) -> list[str]:
    """The policies to test, each once."""
    independent = kind_of(battery).independent
    if cfg.runs is not None and not independent:
        raise ValueError(
            f"runs needs a battery whose trials are the same for all; {battery.name} is not."
        )
    if cfg.trial is not None and not independent:
        raise ValueError(f"trial needs a battery whose trials are independent, got {battery.name}.")
    return [cfg.run] if cfg.runs is None else list(dict.fromkeys(cfg.runs))


def setting_of(
    cfg: DictConfig,
    options: dict[str, Any],
    name: str,
    servo: str | None,
    robot: str | None = None,
) -> str:
    """Name of the folder of results, from all that was given and changes them.

    Args:
        cfg: of the recipe.
        options: numbers of the battery that it replaces.
        name: of the battery's yaml.
        servo: the servos chosen; ``None``: those of the training.
        robot: the robot chosen; ``None``: that of the env.
    """
    stored = table_of(name)
    differs = {str(key): v for key, v in cfg.battery.items() if v != stored[key]}
    given = options | {key: v for key, v in differs.items() if key not in options}
    given |= {"robot": robot} if robot else {}
    given |= {"servo": servo} if servo else {}
    given |= {"change": cfg.change} if cfg.change else {}
    given |= {"keep": sorted(cfg.keep)} if cfg.keep else {}
    given |= {} if cfg.memory else {"memory": False}
    given |= {"seed": cfg.seed} if cfg.seed != 0 else {}
    given |= {"checkpoint": cfg.checkpoint} if cfg.checkpoint != "last" else {}
    return setting_name(name, given)
