"""Makes a bank of falls."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import torch
from hydra.utils import instantiate
from rich.console import Console

from zfall.envs.humanoid import STATE_KEYS
from zfall.falling.banks import PUSH_KEYS, SEEN_KEYS, save_bank
from zfall.falling.pushed import check_world_name, pushed_policy
from zfall.falling.recording import record_falls
from zfall.values import Count, Name, Names, NotNegative, Positive, Rule, Seed

_ONE = Rule("hold at least one", lambda x: len(x) > 0)


class RecordedFalls:
    """States in the midst of falls, see ``zfall.falling.recording.record_falls``.

    Args:
        run: the policy: a run folder, the name of one that ships or of a baseline, or the file of a
            checkpoint.
        checkpoint: of a run folder.
        change: values of its env to replace.
        world: battery whose hardware the policy meets, ``twin``; ``None``: that of its env.
        seed: of starts and pushes.
        starts: per direction, size and push point.
        impulses: dimensionless.
        points: where it is pushed.
        duration: of the pushes [s].
        times: after the push began [s]; ``None``: when the policy's mode machine gives up.
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
        seed: Seed = 0,
        starts: Count = 2,
        impulses: Annotated[Sequence[Positive], _ONE] = (1.0,),
        points: Names = ("torso",),
        duration: Positive = 0.1,
        times: Annotated[Sequence[NotNegative], _ONE] | None = None,
    ):
        check_world_name(world)
        self.tested = pushed_policy(run, checkpoint=checkpoint, change=change)
        self.seed, self.starts, self.impulses = seed, starts, list(impulses)
        self.points, self.duration, self.times = list(points), duration, times
        self.world = world

    def make(self, path: Path, console: Console) -> None:
        """Writes the bank."""
        tested = self.tested
        recording = record_falls(
            tested.env_cfg,
            tested.actor,
            times=self.times,
            points=self.points,
            impulses=self.impulses,
            starts=self.starts,
            duration=self.duration,
            seed=self.seed,
            servos=tested.servos,
            world=self.world,
            console=console,
        )
        save_bank(path, recording.states, control_dt=tested.env_cfg.base_env.control_dt)
        count = len(recording.states["joint_position"])
        console.print(f"{recording.fell} of {recording.trials} trials fell: {count} states")

    def stand_in(self, path: Path) -> None:
        """Writes states of a robot that stands, pushed no more."""
        count = 4
        td = instantiate(self.tested.env_cfg, base_env={"num_envs": count}).reset()
        states = {key: td[key].flatten(1) for key in (*STATE_KEYS, *SEEN_KEYS)}
        rest = dict(zip(PUSH_KEYS, (torch.zeros(count, 3), torch.zeros(count, 1)), strict=True))
        save_bank(path, states | rest, control_dt=self.tested.env_cfg.base_env.control_dt)
