"""Records falls, in whose midst trainings begin: ``python -m recipes.falling.falls run=best``.

A policy is pushed from all sides at some points by more than it withstands; pushes begin in any
physics step. Of every trial that ends on the floor the states nearest to some ``times`` after the
push began are kept, when a trigger may first give up: a fall takes 0.3 s. With ``times=null``, for
a policy that kneels, it is the state at its own trigger, of all trials.
"""

from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console

from zfall.commands import shown_path
from zfall.errors import check_keys, check_lists, check_whole
from zfall.evaluation.candidate import load_candidate
from zfall.falling.banks import save_bank
from zfall.falling.recording import record_falls
from zfall.trust import trusting

from ..shell import one_line_errors, start

PUSHED = ("seed", "starts", "impulses", "points", "duration", "times")  # how


@hydra.main(version_base=None, config_path=".", config_name="falls")
def main(cfg: DictConfig) -> None:
    """Writes ``falls.npz``, see ``zfall.falling.banks.load_bank``."""
    console = Console()
    with one_line_errors(), trusting(cfg.trust):
        check_keys(cfg, {"run", "checkpoint", "change", "trust", *PUSHED})
        check_lists(cfg, ("impulses", "points", "times", "change"))
        check_whole(cfg, ["seed"])
        tested = load_candidate(cfg.run, checkpoint=cfg.checkpoint, change=cfg.change)
        pushed = {key: cfg[key] for key in PUSHED}
        recording = record_falls(tested.env_cfg, tested.actor, servos=tested.servos, **pushed)
    path = Path(HydraConfig.get().runtime.output_dir) / "falls.npz"
    save_bank(path, recording.states)
    count = len(recording.states["joint_position"])
    console.print(f"{recording.fell} of {recording.trials} trials fell")
    console.print(f"wrote {shown_path(path)}: {count} states", soft_wrap=True)


if __name__ == "__main__":
    start(main)
