"""Makes one policy of two."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

from rich.console import Console

from zfall import checkpoint as checkpoints
from zfall.falling.fall_network import load_fall_network
from zfall.falling.switched import SCRIPT, switched_checkpoint
from zfall.falling.trigger import HOLD
from zfall.values import Fraction, Name, Positive

_TARGET = "_target_"


class SwitchedPolicy:
    """A policy that recovers and one that kneels, switched by the mode machine of an env.

    Args:
        recover: the policy that recovers: a run folder, the name of one that ships, or the file of
            a checkpoint.
        kneel: likewise of a policy that kneels; or ``script``, the movements alone.
        env: whose modes switch, by its name in ``recipes/env``.
        checkpoint: of run folders.
        change: values of the env to replace.
        trigger: file of a fall network that gives up; ``None``: the env's own way.
        probability: of a fall, by that network, from which on it gives up.
        hold: for how long [s].
        catches: file of movements that catch a fall; ``None``: the env's own.
        rises: file of movements that get up; ``None``: the env's own.

    Raises:
        ValueError: if a policy is missing, or they do not see or do the same.
    """

    suffix: ClassVar[str] = ".pt"
    is_policy: ClassVar[bool] = True

    def __init__(
        self,
        *,
        recover: Name,
        kneel: Name = SCRIPT,
        env: Name = "push_to_kneel",
        checkpoint: Name = "last",
        change: Sequence[Name] = (),
        trigger: Name | None = None,
        probability: Fraction = 0.9,
        hold: Positive = HOLD,
        catches: Name | None = None,
        rises: Name | None = None,
    ):
        values: dict[str, Any] = {}
        if trigger is not None:
            network = load_fall_network(trigger)
            values["predictor"] = {
                _TARGET: "zfall.falling.modes.FallPredictor",
                "network": {
                    _TARGET: "zfall.falling.fall_network.load_fall_network",
                    "path": trigger,
                },
                "keys": (network.trained_with or {})["keys"],
                "before": "mode",
            }
            values |= {"mode.probability": probability, "mode.hold": hold}
        values |= {"kneel_reference.catches": catches} if catches is not None else {}
        values |= {"rise_reference.rises": rises} if rises is not None else {}
        self.content = switched_checkpoint(
            recover,
            kneel,
            env=env,
            checkpoint_name=checkpoint,
            changes=change,
            values={f"transforms.{key}": value for key, value in values.items()},
        )

    def make(self, path: Path, console: Console) -> None:
        """Writes the checkpoint of both."""
        checkpoints.save(path, self.content)

    def stand_in(self, path: Path) -> None:
        """Writes the same: it takes no longer."""
        checkpoints.save(path, self.content)
