"""Puts a policy that recovers and one that kneels together, switched by the mode machine.

``python -m recipes.falling.switch recover=RUN kneel=RUN hydra.run.dir=runs/switched`` writes a run
folder that ``recipes.evaluate`` takes. With ``kneel=script`` the movements that
``recipes.falling.catches`` found kneel.
"""

from pathlib import Path
from typing import TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Fraction, Name, Positive

from ..shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start
from .made import make_one


class Keys(TypedDict):
    """The keys of ``switch.yaml``."""

    recover: Run
    kneel: Run
    env: Name
    trigger: Name | None
    probability: Fraction
    hold: Positive
    catches: Name | None
    rises: Name | None
    checkpoint: Checkpoint
    trust: Changes
    change: Changes


@hydra.main(version_base=None, config_path=".", config_name="switch")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``checkpoints/last.pt`` with both policies and the env that switches."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    path = Path(HydraConfig.get().runtime.output_dir) / "checkpoints" / "last.pt"
    with trusting(cfg.trust):
        make_one("SwitchedPolicy", cfg, path)


if __name__ == "__main__":
    start(main)
