"""Drives a robot by an exported policy: ``python -m recipes.drive policy=FOLDER``.

``bus=twin`` is a simulated robot and needs no hardware. ``drive.csv`` has a row per control step;
``compare=twin`` runs pushes by the loop and by zfall, and writes ``compare.csv``.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import shown_path
from zfall.configs import plain_containers
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Count, FractionAboveZero, Name, NotNegative, Positive, Rule, Seed

from .shell import Changes, Run, check_recipe, one_line_errors, start

if TYPE_CHECKING:
    from zfall.deployment import Settings
    from zfall.policies.exported import ExportedPolicy

Byte = Annotated[int, Rule("be 0 to 254", lambda x: 0 <= x <= 254)]
Forces = Annotated[Sequence[float], Rule("be two forces", lambda x: len(x) == 2)]


class SettingsKeys(TypedDict):
    """The keys of ``settings``, see ``zfall.deployment.Settings``."""

    kp: Byte | None
    acceleration: Byte
    ceiling: Byte
    torque_limit: FractionAboveZero
    settle: Positive
    watchdog: Positive
    margin: NotNegative
    hottest: Positive | None
    stop: Literal["hold", "limp"]


class Keys(TypedDict):
    """The keys of ``drive.yaml``."""

    policy: Name
    bus: Name | Mapping[str, Any]
    trust: Changes
    seconds: Positive
    force: Forces
    cut: NotNegative | None
    seed: Seed
    realtime: bool
    settings: SettingsKeys
    compare: Run | None
    starts: Count
    impulses: Sequence[Positive]


@hydra.main(version_base=None, config_path=".", config_name="drive")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``drive.csv``, or ``compare.csv``, into hydra's folder."""
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
    with one_line_errors(), trusting(cfg.trust):
        from zfall.deployment import Settings
        from zfall.deployment.log import Log
        from zfall.deployment.loop import Stopped, drive
        from zfall.policies.exported import ExportedPolicy

        policy = ExportedPolicy(Path(cfg.policy))
        settings = Settings(**plain_containers(cfg.settings))
        if cfg.compare is not None:
            compare(cfg, policy, settings, output / "compare.csv")
            return
        bus = bus_of(cfg, policy)
    log = Log(output / "drive.csv", policy.about["joints"])
    try:
        drive(policy, bus, seconds=cfg.seconds, log=log, settings=settings)
    except Stopped:
        raise SystemExit(f"error: {log.events[-1]}.") from None
    finally:
        log.close()
        bus.close()
        print("\n".join(log.report(policy.about["control_dt_s"])))
        print(f"wrote {shown_path(output)}/drive.csv")


def bus_of(cfg: DictConfig, policy: "ExportedPolicy") -> Any:
    """The robot that is driven.

    Raises:
        ValueError: on a bus that there is not.
    """
    if not isinstance(cfg.bus, str):
        from hydra.utils import instantiate

        return instantiate(cfg.bus, _convert_="all")
    from zfall.deployment.simulated import pushed, simulated

    bus = simulated(cfg.bus, policy, realtime=cfg.realtime)
    return pushed(bus, force=tuple(cfg.force), seed=cfg.seed, cut=cfg.cut)


def compare(cfg: DictConfig, policy: "ExportedPolicy", settings: "Settings", path: Path) -> None:
    """Runs the same trials by the loop and by zfall, and prints how they agree."""
    from rich.progress import Progress

    from zfall.deployment.dry_run import agreement
    from zfall.deployment.dry_run import compare as both
    from zfall.deployment.simulated import simulated
    from zfall.evaluation.candidate import load_candidate

    trials = {"starts": cfg.starts, "impulses": list(cfg.impulses)}
    bus = simulated(cfg.bus, policy, realtime=False, **trials)
    own = load_candidate(cfg.compare)
    with Progress() as bar:
        line = bar.add_task("by the loop")
        table = both(
            policy,
            bus,
            own.env_cfg,
            own.actor,
            seed=cfg.seed,
            settings=settings,
            progress=lambda done, total: bar.update(line, completed=done, total=total),
        )
    table.to_csv(path, index=False)
    print("\n".join(agreement(table)))
    print(f"wrote {shown_path(path)}")


if __name__ == "__main__":
    start(main)
