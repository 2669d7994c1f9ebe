"""Lets a policy act in its task, pushes on request, and films it: ``recipes.play run=DIR``."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from zfall.commands import remove_if_empty, shown_path
from zfall.errors import SPOKEN, object_at
from zfall.trust import trusting
from zfall.values import Count, FractionAboveZero, Name, NotNegative, Positive, Seed, Times

from .shell import (
    Changes,
    Checkpoint,
    Run,
    check_recipe,
    choice,
    loading,
    one_line_errors,
    start,
)


class Keys(TypedDict):
    """The keys of ``play.yaml``."""

    run: Run | None
    checkpoint: Checkpoint
    env: NotRequired[Mapping[str, Any] | None]  # servo=NAME alone gives a part of one
    num_envs: Count
    seconds: Positive
    pushes: NotNegative | Sequence[Positive] | None
    apart: Positive | None
    seed: Seed
    trust: Changes
    keep: Changes
    change: Changes
    servo: NotRequired[Any]
    video: bool
    filmed: Count
    slow: FractionAboveZero
    slow_for: Positive | None
    shown: Times | None
    measures: Sequence[Name]


@hydra.main(version_base=None, config_path=".", config_name="play")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``play.json`` and ``play.mp4`` into the run folder, or hydra's if there is none."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        from hydra.utils import instantiate
        from rich.console import Console
        from rich.progress import track

        from zfall.envs.make import left_out
        from zfall.envs.tables import keep
        from zfall.evaluation.battery import BLOCK
        from zfall.evaluation.candidate import load_candidate
        from zfall.evaluation.play import film_of, planned, side_pushes, walk
        from zfall.evaluation.video import Cut

        console = Console()
        check_values(cfg)
        followers = [object_at(path, "measures") for path in cfg.measures]
        player = load_candidate(cfg.run, **loading(cfg))
        env_cfg, actor = keep(player.env_cfg, cfg.keep), player.actor
        worlds = BLOCK * -(-cfg.num_envs // BLOCK)
        world = {"num_envs": worlds, "powered": player.servos}
        env = instantiate(env_cfg, base_env=world, training=False)
        if not cfg.seconds >= (step := env.base_env.control_dt):
            raise ValueError(f"seconds must be at least control_dt {step}, got {cfg.seconds}.")
        if not cfg.filmed <= worlds:
            raise ValueError(f"filmed must be at most num_envs {worlds}, got {cfg.filmed}.")
        cut = Cut(cfg.slow, cfg.slow_for, cfg.shown)
        cut.check(cfg.seconds)
        sizes, apart = planned(env, cfg.pushes, cfg.apart)
        if sizes is not None:
            env.append_transform(side_pushes(env, sizes, cfg.seconds, apart))
    gone = left_out(OmegaConf.select(env_cfg, "training_only", default={}))
    console.print(f"of the env's transforms left out: {', '.join(gone) or 'nothing'}")
    if worlds != cfg.num_envs:
        console.print(f"num_envs: {worlds}, the next multiple of {BLOCK}")
    env.set_seed(cfg.seed)
    played = walk(
        env,
        actor,
        cfg.seconds,
        filmed=cfg.filmed,
        followers=followers,
        follow=lambda steps, total: track(
            steps, "playing", total=total, console=console, transient=True
        ),
    )
    output = Path(HydraConfig.get().runtime.output_dir)
    folder = Path(cfg.run) if Path(cfg.run).is_dir() else output  # one that ships has none
    (folder / "play.json").write_text(
        json.dumps({"checkpoint": cfg.checkpoint, **played.figures}, indent=2)
    )
    written = "play.json"
    for line in played.lines():
        console.print(line)
    if cfg.video:
        try:
            film_of(
                played,
                env.base_env,
                player.label,
                folder / "play.mp4",
                cut=cut,
                follow=lambda frames, total: track(
                    frames, "filming", total=total, console=console, transient=True
                ),
            )
            written += ", play.mp4"
        except RuntimeError as error:
            console.print(f"no video: {error}")
    console.print(f"wrote {shown_path(folder)}/{written}", soft_wrap=True)
    remove_if_empty(output)  # the results lie in the run folder


def check_values(cfg: DictConfig) -> None:
    """Refuses values that make no sense."""
    from zfall.evaluation.baselines import baseline_names

    names = baseline_names()
    if cfg.run is None:
        raise ValueError(f"run must be a run folder, a policy that ships or {' or '.join(names)}.")
    if cfg.run not in names and choice("env"):
        raise ValueError(f"env must be given for baselines alone, {cfg.run} has its own.")


if __name__ == "__main__":
    start(main)
