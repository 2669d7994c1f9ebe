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

from zfall.commands import shown_path
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, Seed

from ..shell import Changes, Checkpoint, Run, check_recipe, one_line_errors, start

WORLDS = 64  # in which robots settle


class Keys(TypedDict):
    """The keys of ``lying.yaml``."""

    run: Run
    checkpoint: Checkpoint
    trust: Changes
    change: Changes
    count: Count
    seed: Seed


@hydra.main(version_base=None, config_path=".", config_name="lying")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``lying.npz``, see ``zfall.falling.lying.load_lying``."""
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        from hydra.utils import instantiate

        from zfall.configs import compose_config
        from zfall.evaluation.candidate import load_candidate
        from zfall.falling.banks import save_bank
        from zfall.falling.lying import POSTURES, joined, kneeling_bank, lying_bank

        tested = load_candidate(cfg.run, checkpoint=cfg.checkpoint, change=cfg.change)
        twin = compose_config(["env=push_recovery_twin", f"num_envs={WORLDS}"]).env.base_env
        env, limp = (instantiate(twin, powered=on, _convert_="all") for on in (True, False))
        kneels = kneeling_bank(tested.env_cfg, tested.actor, cfg.count, seed=cfg.seed)
        bank = joined([lying_bank(env, limp, cfg.count, seed=cfg.seed), kneels])
    path = Path(HydraConfig.get().runtime.output_dir) / "lying.npz"
    save_bank(path, bank)
    counts = [f"{int((bank['posture'] == i).sum())} {name}" for i, name in enumerate(POSTURES)]
    print(f"wrote {shown_path(path)}: {', '.join(counts)}")


if __name__ == "__main__":
    start(main)
