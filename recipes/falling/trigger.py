"""Learns when a fall can no longer be avoided: ``python -m recipes.falling.trigger run=best``.

A policy is pushed, sensors are noisy, and every trial is labelled by its end. A ``FallNetwork``
learns from the measurements, is calibrated on other trials and compared on a third part with the
fixed rule: how early it is, and how often it gives up what would have been recovered.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from zfall.commands import shown_path
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, Names, Positive, Rule, Seed

from ..shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start


class Keys(TypedDict):
    """The keys of ``trigger.yaml``."""

    run: Run
    checkpoint: Checkpoint
    trust: Changes
    change: Changes
    keep: Changes | None
    seed: Seed
    measured: Names
    hidden_size: Count
    epochs: Count
    starts: Count
    impulses: Annotated[Sequence[Positive], Rule("hold at least one", lambda x: len(x) > 0)]


PUSHED = ("measured", "impulses", "starts", "seed")  # what is recorded
LEARNED = ("hidden_size", "epochs")
ON = ("noise", "delay")  # transforms that stay on by themselves, where there are any


@hydra.main(version_base=None, config_path=".", config_name="trigger")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``fall_network.pt``, ``trigger.csv``, ``trigger.md``, ``reliability.csv``, figures."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        import torch
        from rich.console import Console

        from zfall.envs.tables import keep
        from zfall.evaluation.candidate import load_candidate
        from zfall.evaluation.writers import markdown
        from zfall.falling import trigger
        from zfall.falling.fall_network import save_fall_network
        from zfall.falling.plots import reliability_plot, reliability_table, trigger_plot
        from zfall.terminal import Sheet, print_sheet

        console = Console()
        tested = load_candidate(cfg.run, checkpoint=cfg.checkpoint, change=cfg.change)
        there = OmegaConf.select(tested.env_cfg, "training_only", default={})
        kept = [name for name in ON if name in there] if cfg.keep is None else cfg.keep
        env_cfg = keep(trigger.without_trigger(tested.env_cfg), kept)
        torch.manual_seed(cfg.seed)
        with console.status("pushed trials"):
            pushed = {key: cfg[key] for key in PUSHED}
            history, control_dt = trigger.record(
                env_cfg, tested.actor, servos=tested.servos, **pushed
            )
        train, calibration, test = trigger.split(history, torch.randperm(len(history.fell)))
    console.print(f"{len(history.fell)} trials, {int(history.fell.sum())} of them falls")

    def tell(epoch: int, loss: float) -> None:
        if epoch % 10 == 0:
            console.print(f"epoch {epoch} of {cfg.epochs}: loss {loss:.4f}")

    sizes = {key: cfg[key] for key in LEARNED}
    network = trigger.fit(train, list(cfg.measured), control_dt, progress=tell, **sizes)
    trigger.calibrate(network, calibration)
    save_fall_network(network, folder / "fall_network.pt")
    probability, truth = trigger.probabilities(network, test), trigger.labels(test)
    rows = trigger.comparison(test, probability, control_dt)
    rows.to_csv(folder / "trigger.csv", index=False)
    (folder / "trigger.md").write_text(markdown(rows))
    sure = reliability_table(probability[test.live].numpy(), truth[test.live].numpy())
    sure.to_csv(folder / "reliability.csv", index=False)
    for ending in ("png", "pdf"):
        reliability_plot(sure, folder / f"reliability.{ending}")
        trigger_plot(rows, folder / f"trigger.{ending}")
    print_sheet(Sheet(rows, file=str(folder / "trigger.md")), console)
    written = "fall_network.pt, trigger.csv, trigger.md, reliability.csv, reliability, trigger"
    console.print(f"wrote {shown_path(folder)}/{written}", soft_wrap=True)


if __name__ == "__main__":
    start(main)
