"""Recovery over the width of randomisation, as a table: ``python -m recipes.sweep run=R``.

The battery's world is made narrower and wider, and the policy put to each. A call with the same
``hydra.run.dir`` goes on where an interrupted one stopped.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import shown_path
from zfall.configs import plain_containers
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, NotNegative, Positive, Rule, Seed

from .shell import (
    Changes,
    Checkpoint,
    Run,
    Starts,
    check_recipe,
    one_line_errors,
    servo_change,
    start,
)


class Keys(TypedDict):
    """The keys of ``sweep.yaml``."""

    run: Run
    battery: Mapping[str, Any]
    env: NotRequired[Mapping[str, Any] | None]  # servo=NAME alone gives a part of one
    servo: NotRequired[Any]
    checkpoint: Checkpoint
    trust: Changes
    widths: Annotated[Sequence[NotNegative], Rule("hold at least one", lambda x: len(x) > 0)]
    num_envs: Count
    seed: Seed
    starts: Starts
    impulses: Sequence[Positive] | None


@hydra.main(version_base=None, config_path=".", config_name="sweep")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``sweep.csv`` and ``sweep.md``, and the trials of each width."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        from rich.console import Console

        from zfall.evaluation.battery import battery_env
        from zfall.evaluation.candidate import load_candidates, read_trials, write_trials
        from zfall.evaluation.definitions import Battery, battery_of
        from zfall.evaluation.run import trials_of
        from zfall.evaluation.sweep import sweep_table, widened
        from zfall.evaluation.writers import write_table
        from zfall.terminal import Sheet, print_sheet

        console = Console()
        options = {key: cfg[key] for key in ("starts", "impulses") if cfg[key] is not None}
        table = plain_containers(cfg.battery)
        if not table.get("world"):
            raise ValueError(
                f"battery.world must be a table that draws something, got null of "
                f"{cfg.battery.name}: zeroth_sweep has one."
            )
        first = battery_of(table, **options)
        (tested,) = load_candidates(
            [cfg.run], checkpoint=cfg.checkpoint, change=servo_change(), world=first.world
        )
        env, *_ = battery_env(first, tested.env_cfg, 1)
        ranges, batteries = env.base_env.parameters.ranges, dict[float, Battery]()
        for width in cfg.widths:
            world = widened(table["world"], width, ranges)
            batteries[width] = battery_of({**table, "world": world}, **options)
            battery_env(batteries[width], tested.env_cfg, 1)  # refused before any of them runs
    found = {}
    for width, battery in batteries.items():
        path = folder / f"width_{width:g}" / "trials.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        conditions = tested.conditions(battery, seed=cfg.seed)
        done = read_trials(path, conditions)
        if done is None:
            given: dict[str, Any] = {"seed": cfg.seed, "num_envs": cfg.num_envs}
            given |= {"console": console, "folder": path.parent, "conditions": conditions}
            done = trials_of(battery, tested, label=f"width {width:g}", **given)
            write_trials(path, done, conditions)
        found[width] = done
    rows = sweep_table(first, found)
    written = write_table(folder, "sweep", rows)
    console.print(f"{cfg.run}, {cfg.battery.name}: share recovered by width of randomisation")
    print_sheet(Sheet(rows, file=str(folder / "sweep.csv")), console)
    console.print(f"wrote {shown_path(folder)}/{', '.join(written)}", soft_wrap=True)


if __name__ == "__main__":
    start(main)
