"""Writes a policy for a robot: ``python -m recipes.export run=best``.

``policy.onnx`` is all that the robot's computer does in a control step, from the sensors to the
targets of the servos; ``policy.json`` says what its numbers mean. ``zfall drive`` runs both.
``planar=5`` puts the exported policy to battery planar, in dm_control, and the policy itself.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import remove_if_empty, shell_line, shown_path
from zfall.errors import SPOKEN
from zfall.trust import trusting

from .shell import Changes, Checkpoint, Run, Starts, check_recipe, one_line_errors, start


class Keys(TypedDict):
    """The keys of ``export.yaml``."""

    run: Run
    checkpoint: Checkpoint
    trust: Changes
    change: Changes
    planar: Starts


@hydra.main(version_base=None, config_path=".", config_name="export")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``policy.onnx`` and ``policy.json``."""
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        from zfall.evaluation.battery import battery_env
        from zfall.evaluation.candidate import load_candidate
        from zfall.evaluation.definitions import load_battery
        from zfall.policies.export import describe, export_policy

        starts = cfg.planar
        policy = load_candidate(cfg.run, checkpoint=cfg.checkpoint, change=cfg.change)
        if policy.actor is None:
            raise ValueError(f"run must hold a policy, {cfg.run} is a baseline.")
        env, _, _ = battery_env(load_battery("planar"), policy.env_cfg, 1)
        # One that ships has no folder.
        folder = Path(cfg.run) / "export" if Path(cfg.run).is_dir() else output
        folder.mkdir(exist_ok=True)
        try:
            robot_policy = export_policy(env, policy.actor, folder / "policy.onnx")
        finally:
            remove_if_empty(folder)
        about = describe(env, robot_policy, policy.env_cfg) | {"checkpoint": cfg.checkpoint}
    (folder / "policy.json").write_text(json.dumps(about, indent=2))
    remove_if_empty(output)  # what was written lies in the run folder
    place = shown_path(folder)
    print(f"wrote {place}/policy.onnx, policy.json")
    print(f"to drive the simulated robot: {shell_line('drive', f'policy={place}')}")
    if starts is None:
        return
    from rich.progress import Progress, TimeElapsedColumn

    from zfall.evaluation.exported import compare_planar

    with one_line_errors(), Progress(*Progress.get_default_columns(), TimeElapsedColumn()) as bar:

        def follow(name: str) -> Callable[[int, int], None]:
            line = bar.add_task(name)
            return lambda done, total: bar.update(line, completed=done, total=total)

        battery = load_battery("planar", starts=starts).of_size(policy.robot)
        text = compare_planar(battery, policy.env_cfg, policy.actor, folder, follow)
    print(f"{text}\nwrote {place}/planar.csv")


if __name__ == "__main__":
    start(main)
