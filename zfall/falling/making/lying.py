"""Makes a bank of robots that lie and kneel."""

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

import torch
from hydra.utils import instantiate
from rich.console import Console

from zfall.configs import compose_config
from zfall.envs.humanoid import STATE_KEYS, HumanoidEnv
from zfall.falling.banks import save_bank
from zfall.falling.lying import POSTURES, joined, kneeling_bank, lying_bank
from zfall.falling.pushed import check_world_name, pushed_policy
from zfall.values import Count, Name, Seed

WORLDS = 64  # in which robots settle


class LyingStates:
    """How robots lie and kneel before they get up.

    They are let go just above the floor, on the back, the belly and each side, with noise on their
    joints: half of them with servos that hold, half of them limp. Those that come to rest in the
    posture are kept. Kneels are those in which a policy that kneels comes to rest after pushes.

    Args:
        run: that policy: a run folder, the name of one that ships or of a baseline, or the file of
            a checkpoint.
        checkpoint: of a run folder.
        change: values of its env to replace.
        world: battery whose hardware the policy meets, ``twin``; ``None``: that of its env.
        count: states of each posture.
        seed: of noise and pushes.
    """

    suffix: ClassVar[str] = ".npz"
    is_policy: ClassVar[bool] = False

    def __init__(
        self,
        *,
        run: str,
        checkpoint: Name = "last",
        change: Sequence[Name] = (),
        world: Name | None = None,
        count: Count = 64,
        seed: Seed = 0,
    ):
        check_world_name(world)
        self.tested = pushed_policy(run, checkpoint=checkpoint, change=change)
        self.world, self.count, self.seed = world, count, seed

    def make(self, path: Path, console: Console) -> None:
        """Writes the bank."""
        tested = self.tested
        kneels = kneeling_bank(
            tested.env_cfg,
            tested.actor,
            self.count,
            seed=self.seed,
            world=self.world,
            console=console,
        )
        with console.status("robots that settle"):
            env, limp = (_twin(WORLDS, powered=on) for on in (True, False))
            bank = joined([lying_bank(env, limp, self.count, seed=self.seed), kneels])
        save_bank(path, bank)
        counts = [f"{int((bank['posture'] == i).sum())} {name}" for i, name in enumerate(POSTURES)]
        console.print(", ".join(counts), soft_wrap=True)

    def stand_in(self, path: Path) -> None:
        """Writes a robot that stands, called one in each posture."""
        env = _twin(len(POSTURES), powered=True)
        td = env.reset()
        states = {key: td[key].flatten(1) for key in STATE_KEYS}
        states["target"] = env.stand_position.repeat(len(POSTURES), 1)
        save_bank(path, states | {"posture": torch.arange(len(POSTURES))})


def _twin(worlds: int, *, powered: bool) -> HumanoidEnv:
    config = compose_config(["env=push_recovery_twin", f"num_envs={worlds}"]).env.base_env
    env: HumanoidEnv = instantiate(config, powered=powered, _convert_="all")
    return env
