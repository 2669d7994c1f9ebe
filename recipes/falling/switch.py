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

from zfall.commands import shown_path
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Name

from ..shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start


class Keys(TypedDict):
    """The keys of ``switch.yaml``."""

    recover: Run
    kneel: Run
    env: Name
    checkpoint: Checkpoint
    trust: Changes
    change: Changes


@hydra.main(version_base=None, config_path=".", config_name="switch")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``checkpoints/last.pt`` with both policies and the env that switches."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        from zfall import checkpoint
        from zfall.falling.switched import switched_checkpoint

        content = switched_checkpoint(
            cfg.recover,
            cfg.kneel,
            env=cfg.env,
            checkpoint_name=cfg.checkpoint,
            changes=cfg.change,
        )
    path = Path(HydraConfig.get().runtime.output_dir) / "checkpoints" / "last.pt"
    path.parent.mkdir(parents=True, exist_ok=True)
    checkpoint.save(path, content)
    print(f"wrote {shown_path(path)}")


if __name__ == "__main__":
    start(main)
