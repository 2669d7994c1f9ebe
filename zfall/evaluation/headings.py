"""What stands over a figure of a battery: who was tested, on what, how often, and the unit of I."""

from collections.abc import Sequence

import pandas as pd
from omegaconf import DictConfig, OmegaConf

from zfall.envs.worlds import in_world
from zfall.evaluation.definitions import Battery
from zfall.robots import Robot
from zfall.robots.servos import SERVOS


def heading(
    what: str, battery: Battery, robot: Robot, surroundings: str = "", counted: str = ""
) -> str:
    """Two lines: what is shown of which battery; then its world, the number of trials and I = 1.

    Args:
        what: the policy's label, or the quantity.
        battery: the definition, with times of this robot.
        robot: whose unit of impulse is told.
        surroundings: servos and world, see ``surroundings``.
        counted: how many trials are behind a value, see ``count``.
    """
    first = f"{what}: battery {battery.name}"
    if len(battery.points) == 1:
        thrown = "balls" if _thrown(battery) else "pushes"
        first += f", {thrown} at the {battery.points[0].replace('_', ' ')}"
    return f"{first}\n" + "; ".join(x for x in (surroundings, counted, unit(battery, robot)) if x)


def unit(battery: Battery, robot: Robot) -> str:
    """What I = 1 is on a robot: a force for a time, or of balls and several times an impulse."""
    size, (duration, *others) = robot.impulse_unit, battery.durations
    if others or _thrown(battery):
        return f"I = 1 is {size:.2g} N s"
    return f"I = 1 is {size / duration:.0f} N for {duration:g} s"


def _thrown(battery: Battery) -> bool:
    """Whether balls push."""
    return "ball" in (battery.world or {}).get("base_env", {})


def count(trials: pd.DataFrame, keys: Sequence[str], words: str) -> str:
    """How many pushed trials share values of some columns: ``20 trials per direction and size``.

    Args:
        trials: of a battery.
        keys: columns whose values make up a cell; none: all trials are one.
        words: that follow the number.
    """
    pushed = trials[trials["impulse"] > 0]
    sizes = pushed.groupby(list(keys)).size() if keys else pd.Series([len(pushed)])
    least, most = (int(sizes.min()), int(sizes.max())) if len(sizes) else (0, 0)
    if least == most == 1:
        words = words.replace("trials", "trial")
    return f"{least}{f' to {most}' if most > least else ''} {words}"


def surroundings(env_cfg: DictConfig, battery: Battery, kept: Sequence[str] = ()) -> str:
    """Servos and world of a battery's trials: ``published servos, nominal world``.

    Args:
        env_cfg: config of the policy's env.
        battery: the definition; its world replaces the env's hardware.
        kept: what of the env's ``training_only`` is left on.
    """
    words = ["nominal world" if battery.world is None else "the battery's own world"]
    words += [f"with {' and '.join(kept)}"] if kept else []
    if battery.foot_friction is not None:
        words.append(f"foot friction {battery.foot_friction:g}")
    if battery.mass_factor is not None:
        words.append("masses x {:g} to {:g}".format(*battery.mass_factor))
    if battery.load is not None:
        words.append("load of {:g} to {:g} kg".format(*battery.load))
    return ", ".join([servos_of(in_world(env_cfg, battery.world)), *words])


def servos_of(env_cfg: DictConfig) -> str:
    """Whose servos an env has: the sheets', the published ones, those of an MJCF, or others.

    Losses under load, sag and overload, ``servo_dynamics``, are said as well.
    """
    servos = OmegaConf.select(env_cfg, "base_env.servos")
    if not servos:
        own = OmegaConf.select(env_cfg, "base_env.robot") is not None
        return "motors of its MJCF" if own else "published servos"
    plain = {"_target_", "name", "kp"}  # all else would be a change of what the sheet says
    by_sheet = all(each.get("name") in SERVOS and set(each) <= plain for each in servos.values())
    losses = " with losses" if OmegaConf.select(env_cfg, "base_env.servo_dynamics") else ""
    return ("sheets' servos" if by_sheet else "servos of its own") + losses
