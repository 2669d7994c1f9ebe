"""Makes the network that decides when a fall can no longer be avoided."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, ClassVar

import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf
from rich.console import Console

from zfall.commands import shown_path
from zfall.envs.tables import keep
from zfall.evaluation.writers import markdown
from zfall.falling import trigger
from zfall.falling.fall_network import SEEN, FallNetwork, save_fall_network
from zfall.falling.plots import reliability_plot, reliability_table, trigger_plot
from zfall.falling.pushed import check_world_name, pushed_policy
from zfall.terminal import Sheet, print_sheet
from zfall.values import Count, Name, Names, Positive, Rule, Seed

ON = ("noise", "delay")  # transforms that stay on by themselves, where there are any
SIZES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0)


class TrainedTrigger:
    """A ``FallNetwork`` for a policy, learned from pushed trials that are labelled by their end.

    It is calibrated on other trials. On a third part it is compared with the fixed rule: how early
    it is, and how often it gives up what would have been recovered. Next to the network are
    ``trigger.csv``, ``trigger.md``, ``reliability.csv`` and figures.

    Args:
        run: the policy: a run folder, the name of one that ships, or the file of a checkpoint.
        checkpoint: of a run folder.
        change: values of its env to replace.
        keep: what of the env's ``training_only`` to leave on; ``None``: noise and delay.
        world: battery whose hardware the policy meets, ``twin``; ``None``: that of its env.
        seed: of starts, pushes and learning.
        measured: what the network sees.
        hidden_size: of the network.
        epochs: passes over the trials.
        starts: trials per direction and size.
        impulses: dimensionless.
    """

    suffix: ClassVar[str] = ".pt"
    is_policy: ClassVar[bool] = False

    def __init__(
        self,
        *,
        run: str,
        checkpoint: Name = "last",
        change: Sequence[Name] = (),
        keep: Sequence[Name] | None = None,
        world: Name | None = None,
        seed: Seed = 0,
        measured: Names = SEEN,
        hidden_size: Count = 32,
        epochs: Count = 40,
        starts: Count = 6,
        impulses: Annotated[
            Sequence[Positive], Rule("hold at least one", lambda x: len(x) > 0)
        ] = SIZES,
    ):
        check_world_name(world)
        self.tested = pushed_policy(run, checkpoint=checkpoint, change=change)
        self.keep, self.world, self.seed = keep, world, seed
        self.measured, self.hidden_size, self.epochs = list(measured), hidden_size, epochs
        self.starts, self.impulses = starts, list(impulses)

    def make(self, path: Path, console: Console) -> None:
        """Writes the network, and what it is worth next to it."""
        tested = self.tested
        there = OmegaConf.select(tested.env_cfg, "training_only", default={})
        kept = [name for name in ON if name in there] if self.keep is None else self.keep
        kept = [] if self.world else kept
        env_cfg = keep(trigger.without_trigger(tested.env_cfg), kept)
        torch.manual_seed(self.seed)
        history, control_dt = trigger.record(
            env_cfg,
            tested.actor,
            measured=self.measured,
            impulses=self.impulses,
            starts=self.starts,
            seed=self.seed,
            servos=tested.servos,
            world=self.world,
            console=console,
        )
        train, calibration, test = trigger.split(history, torch.randperm(len(history.fell)))
        console.print(f"{len(history.fell)} trials, {int(history.fell.sum())} of them falls")

        def tell(epoch: int, loss: float) -> None:
            if epoch % 10 == 0:
                console.print(f"epoch {epoch} of {self.epochs}: loss {loss:.4f}")

        sizes = {"hidden_size": self.hidden_size, "epochs": self.epochs}
        network = trigger.fit(train, self.measured, control_dt, progress=tell, **sizes)
        trigger.calibrate(network, calibration)
        save_fall_network(network, path)
        _report(network, test, control_dt, path.parent, console)

    def stand_in(self, path: Path) -> None:
        """Writes a network that has not learned anything."""
        env = instantiate(self.tested.env_cfg, base_env={"num_envs": 1})
        spec = env.observation_spec
        if missing := [key for key in self.measured if key not in spec.keys()]:
            raise ValueError(f"measured must name keys of the env, got {missing[0]}.")
        network = FallNetwork(sum(spec[key].shape[-1] for key in self.measured), self.hidden_size)
        network.trained_with = {"keys": self.measured, "control_dt": env.base_env.control_dt}
        save_fall_network(network, path)


def _report(
    network: FallNetwork,
    test: trigger.History,
    control_dt: float,
    folder: Path,
    console: Console,
) -> None:
    """What a network is worth on trials from which it has not learned."""
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
    written = "trigger.csv, trigger.md, reliability.csv, reliability, trigger"
    console.print(f"wrote {shown_path(folder)}/{written}", soft_wrap=True)
