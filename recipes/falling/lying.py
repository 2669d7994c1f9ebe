"""Records how robots lie and kneel before they get up: ``python -m recipes.falling.lying``.

Robots are let go just above the floor, on the back, the belly and each side, with noise on their
joints: half of them with servos that hold, half of them limp. Those that come to rest in the
posture are kept. Kneels are those in which a policy that kneels comes to rest after pushes.
"""

from pathlib import Path
from typing import TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, Name, Seed

from ..shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start
from .made import make_one


class Keys(TypedDict):
    """The keys of ``lying.yaml``."""

    run: Run
    checkpoint: Checkpoint
    trust: Changes
    change: Changes
    world: Name | None
    count: Count
    seed: Seed


@hydra.main(version_base=None, config_path=".", config_name="lying")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``lying.npz``, see ``zfall.falling.lying.load_lying``."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    with trusting(cfg.trust):
        make_one("LyingStates", cfg, Path(HydraConfig.get().runtime.output_dir) / "lying.npz")


if __name__ == "__main__":
    start(main)
