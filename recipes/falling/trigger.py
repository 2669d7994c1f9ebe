"""Learns when a fall can no longer be avoided: ``python -m recipes.falling.trigger run=best``.

A policy is pushed, sensors are noisy, and every trial is labelled by its end. A ``FallNetwork``
learns from the measurements, is calibrated on other trials and compared on a third part with the
fixed rule: how early it is, and how often it gives up what would have been recovered.
"""

from pathlib import Path
from typing import NamedTuple

import hydra
import numpy as np
import pandas as pd
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from recipes.shell import one_line_errors, start
from zfall.envs.tables import keep, robot_of
from zfall.envs.terms.falls import body_contact
from zfall.envs.transforms.observations.measured import read_measured
from zfall.errors import check_keys, check_lists, check_whole
from zfall.evaluation.battery import arrange, battery_env, play
from zfall.evaluation.candidate import held, load_run
from zfall.evaluation.definitions import load_battery, plan_pushes, plan_trials
from zfall.evaluation.plots import reliability_plot, trigger_plot
from zfall.evaluation.results import markdown
from zfall.falling.fall_network import FallNetwork, save_fall_network
from zfall.falling.modes import KNEEL, ModeRule, in_danger, modes_over
from zfall.rotations import tilt


class History(NamedTuple):
    """Trials ``(K, T, ...)`` at control steps after the reset.

    ``measured`` what the network sees; ``lean`` [rad] and ``rate`` [rad/s] of the trunk; ``live``
    whether nothing but the feet has touched yet, bool; ``fell`` ``(K,)`` whether it will;
    ``pushed`` ``(K, T)`` whether the push has begun.
    """

    measured: Tensor
    lean: Tensor
    rate: Tensor
    live: Tensor
    fell: Tensor
    pushed: Tensor


@hydra.main(version_base=None, config_path=".", config_name="trigger")
def main(cfg: DictConfig) -> None:
    """Writes ``fall_network.pt``, ``trigger.csv``, ``trigger.md`` and figures."""
    console, folder = Console(), Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        known = {
            "run",
            "checkpoint",
            "change",
            "keep",
            "seed",
            "measured",
            "starts",
            "epochs",
        }
        check_keys(cfg, known | {"hidden_size", "impulses"})
        check_lists(cfg, ("measured", "impulses", "keep", "change"))
        check_whole(cfg, ("epochs", "hidden_size"), 1)
        check_whole(cfg, ["seed"])
        env_cfg, actor = load_run(cfg, cfg.run)
        there = OmegaConf.select(env_cfg, "training_only", default={})
        kept = [name for name in ("noise", "delay") if name in there]
        env_cfg = keep(without_trigger(env_cfg), kept if cfg.keep is None else cfg.keep)
        torch.manual_seed(cfg.seed)
        with console.status("pushed trials"):
            history, control_dt = record(env_cfg, actor, cfg)
        train, held, test = split(history, torch.randperm(len(history.fell)))
        for part in (train, held, test):
            if part.fell.all() or not part.fell.any():
                raise ValueError(
                    "impulses and starts must give trials that fall and that do not, in each of "
                    f"three parts; of {len(part.fell)} {int(part.fell.sum())} fell."
                )
    console.print(f"{len(history.fell)} trials, {int(history.fell.sum())} of them falls")
    network = fit(train, cfg, control_dt, console)
    calibrate(network, held)
    save_fall_network(network, folder / "fall_network.pt")
    probability, truth = probabilities(network, test), labels(test)
    rows = pd.concat(
        [
            table("network", test, learned(probability), control_dt),
            table("rule", test, ruled(test, control_dt), control_dt),
        ],
        ignore_index=True,
    )
    rows.to_csv(folder / "trigger.csv", index=False)
    (folder / "trigger.md").write_text(markdown(rows))
    for ending in ("png", "pdf"):
        reliability_plot(
            probability[test.live].numpy(),
            truth[test.live].numpy(),
            folder / f"reliability.{ending}",
        )
        trigger_plot(rows, folder / f"trigger.{ending}")
    console.print(markdown(rows), markup=False, soft_wrap=True)
    console.print(f"wrote {folder}/fall_network.pt, trigger.csv, trigger.md, reliability, trigger")


def without_trigger(env_cfg: DictConfig) -> DictConfig:
    """The env's config, in which a policy with modes recovers all the time.

    Its kneels would count as falls, and the network would learn to give up when it does.
    """
    if OmegaConf.select(env_cfg, "transforms.mode") is None:
        return env_cfg
    new = held(env_cfg.copy())
    OmegaConf.update(new, "transforms.mode.hold", 1000.0, force_add=True)
    OmegaConf.update(new, "transforms.mode.initial", "recover", force_add=True)
    return new


def split(history: History, order: Tensor) -> list[History]:
    """Three parts: 60, 20 and 20 %."""
    count = len(order)
    cuts = order.tensor_split([int(0.6 * count), int(0.8 * count)])
    return [History(*(value[rows] for value in history)) for rows in cuts]


def record(
    env_cfg: DictConfig, actor: torch.nn.Module | None, cfg: DictConfig
) -> tuple[History, float]:
    """Runs pushed trials; returns them and the control step [s]."""
    battery = load_battery(
        "planar",
        impulses=list(cfg.impulses),
        starts=cfg.starts,
        directions=24,
        push_time=0.52,
        end_time=3.0,
    )
    trials = plan_trials(battery, robot_of(env_cfg).impulse_unit, cfg.seed)
    worlds = 64 * -(-len(trials) // 64)
    env, begin, push = battery_env(battery, env_cfg, worlds, servos=cfg.run != "limp")
    base = env.base_env
    env.set_seed(cfg.seed)
    rows = np.arange(base.num_envs).clip(max=len(trials) - 1)
    pushes = plan_pushes(battery, trials).sooner(base.control_dt, base.physics_dt, cfg.seed)[rows]
    arrange(battery, trials.iloc[rows], pushes, base, begin, push)
    steps: list[list[Tensor]] = []
    live = torch.ones(base.num_envs, dtype=torch.bool)
    for td in play(env, actor, round(battery.end_time / base.control_dt)):
        live = live & ~(body_contact(td, td) | td["diverged"]).squeeze(-1)
        missing = [str(key) for key in cfg.measured if td.get(key, None) is None]
        if missing:
            raise ValueError(f"measured must name keys of the env, got {missing[0]}.")
        measured = torch.cat([read_measured(td, key).flatten(1) for key in cfg.measured], -1)
        rate = td["base_angular_velocity"].norm(dim=-1)
        steps.append([measured, tilt(td["base_orientation"]), rate, live])
    values = [torch.stack(column, 1)[: len(trials)] for column in zip(*steps, strict=True)]
    measured, lean, rate, alive = values
    time = base.control_dt * torch.arange(1, len(steps) + 1)
    pushed = time > pushes.time[: len(trials)] + 1e-6
    return History(measured, lean, rate, alive, ~live[: len(trials)], pushed), base.control_dt


def labels(history: History) -> Tensor:
    """Whether each trial will end on the floor ``(K, T)``; before the push none is sure to."""
    return (history.fell[:, None] & history.pushed).float()


def fit(history: History, cfg: DictConfig, control_dt: float, console: Console) -> FallNetwork:
    """Trains on all steps before the first touch."""
    network = FallNetwork(history.measured.shape[-1], cfg.hidden_size)
    network.trained_with = {"keys": OmegaConf.to_container(cfg.measured), "control_dt": control_dt}
    network.normalizer.update(history.measured[history.live])
    optimizer = torch.optim.Adam(network.parameters(), lr=3e-3)
    truth = labels(history)
    for epoch in range(cfg.epochs):
        total = 0.0
        for rows in torch.randperm(len(truth)).split(128):
            logits, _ = network.logits(history.measured[rows])
            live = history.live[rows]
            loss = binary_cross_entropy_with_logits(logits[live], truth[rows][live])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            total += loss.item() * len(rows)
        if (epoch + 1) % 10 == 0:
            console.print(f"epoch {epoch + 1} of {cfg.epochs}: loss {total / len(truth):.4f}")
    return network.eval()


def calibrate(network: FallNetwork, history: History) -> None:
    """Fits slope and offset of the logits on trials that were not learned from.

    Its targets fall short of 0 and 1, as much as so few could tell (Platt 1999, eq. 1).
    """
    with torch.no_grad():
        logits = network.logits(history.measured)[0][history.live]
    truth = labels(history)[history.live]
    ones = truth.sum()
    truth = torch.where(truth > 0, (ones + 1) / (ones + 2), 1 / (len(truth) - ones + 2))
    scale = torch.tensor([1.0, 0.0], requires_grad=True)
    optimizer = torch.optim.LBFGS([scale], max_iter=100, line_search_fn="strong_wolfe")

    def loss() -> Tensor:
        optimizer.zero_grad()
        value = binary_cross_entropy_with_logits(scale[0] * logits + scale[1], truth)
        value.backward()
        return value

    optimizer.step(loss)
    network.slope.copy_(scale[0].detach())
    network.offset.copy_(scale[1].detach())


@torch.no_grad()
def probabilities(network: FallNetwork, history: History) -> Tensor:
    """Calibrated probability at every step ``(K, T)``."""
    logits, _ = network.logits(history.measured)
    return torch.sigmoid(network.slope * logits + network.offset)


def learned(probability: Tensor) -> dict[str, Tensor]:
    """Steps ``(K, T)`` at which the network has triggered, by threshold."""
    thresholds = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99)
    return {f"{p:g}": (probability > p).cummax(1).values for p in thresholds}


def ruled(history: History, control_dt: float) -> dict[str, Tensor]:
    """Likewise of the fixed rule, by tilt, angular velocity and hold."""
    out = {}
    for hold in (0.04, 0.08, 0.2):
        rule = ModeRule(hold=max(1, round(hold / control_dt)), rest=10**6)
        for rate in (2.0, 4.0, np.inf):
            for angle in (0.3, 0.4, 0.5, 0.6, 0.7):
                danger = in_danger(history.lean, history.rate, angle=angle, angular_velocity=rate).T
                no = torch.zeros_like(danger)
                name = f"{angle:g} rad, {rate:g} rad/s, {hold:g} s"
                out[name] = modes_over(rule, danger, no, no).T >= KNEEL
    return out


def table(
    kind: str, history: History, triggered: dict[str, Tensor], control_dt: float
) -> pd.DataFrame:
    """How early and how often wrong each trigger is.

    ``detected``: share of the falls that it saw between the push's begin and the first touch, and
    not before; ``lead_s``: median time from trigger to touch in these; ``false_alarms``: share of
    the other trials it gave up.
    """
    rows = []
    steps = torch.arange(history.live.shape[1])
    touch = torch.where(history.live, 10**6, steps).amin(1)
    begin = (~history.pushed).sum(1)  # the first step after the push has begun
    for name, state in triggered.items():
        first = torch.where(state, steps, 10**6).amin(1)
        falls, stays = history.fell, ~history.fell
        seen = falls & (first < touch) & (first >= begin)
        lead = ((touch - first)[seen].double() * control_dt).median() if seen.any() else torch.nan
        rows.append(
            {
                "trigger": kind,
                "setting": name,
                "detected": float(seen.sum() / falls.sum()),
                "lead_s": float(lead),
                "false_alarms": float((first[stays] < 10**6).double().mean()),
            }
        )
    return pd.DataFrame(rows)


if __name__ == "__main__":
    start(main)
