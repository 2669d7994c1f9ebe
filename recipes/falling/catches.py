"""Looks for movements that catch a fall: ``python -m recipes.falling.catches falls=FILE``.

For each of twelve headings and some speeds, falls that ``recipes.falling.falls`` recorded after pushes at
the torso go on with the joints going through a few postures, without a policy. The best of many
movements are kept and varied, again and again (cross-entropy method, Rubinstein 1999), each tried
on other falls every time. Good is what comes to rest with torso and head never on the floor,
better upright on a knee or shin, and what lands softly, on torso or head if it must. Goes on from
what the robot has, and keeps that where it is better; takes an hour.
"""

import math
from itertools import pairwise, product
from pathlib import Path
from typing import NamedTuple
from zipfile import BadZipFile

import hydra
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from tensordict import TensorDict
from torch import Tensor

from recipes.shell import one_line_errors, start
from zfall.envs.humanoid import STATE_KEYS, HumanoidEnv
from zfall.errors import check_keys, check_lists, check_number, check_whole
from zfall.falling.movements import HEADINGS, catches_path, load_catches, save_catches
from zfall.falling.terms import resting_kneel
from zfall.rotations import turn_to_heading

END, SPEED = 1.5, 6.0  # of a trial [s]; of each joint, as that of KneelReference [rad/s]
AFTER = 0.5  # for which a trial goes on once torso or head touched [s], as in battery planar
FORCE, ACCELERATION = 1200.0, 400.0  # worst that a score tells apart [N, m/s2]
KEYS = {
    "falls",
    "headings",
    "speeds",
    "until",
    "candidates",
    "trials",
    "elite",
    "rounds",
    "spread",
    "seed",
}


class Falls:
    """Recorded falls, with which worlds begin.

    Args:
        env: the base env.
        path: the file.
    """

    def __init__(self, env: HumanoidEnv, path: Path):
        if not path.is_file():
            raise ValueError(
                f"falls must be a file that recipes.falling.falls wrote, there is no {path}."
            )
        wanted = {*STATE_KEYS, "push_force", "push_left"}
        try:
            with np.load(path) as file:
                arrays = {key: torch.from_numpy(file[key]).float() for key in wanted}
        except (ValueError, KeyError, AttributeError, BadZipFile) as error:
            raise ValueError(
                f"falls must be a file that recipes.falling.falls wrote, {path} is none."
            ) from error
        self.states = {key: arrays[key] for key in STATE_KEYS}
        self.force, self.left = arrays["push_force"], arrays["push_left"][:, 0]
        self.env, count = env, len(self.force)
        velocity = torch.empty(count, 2)
        soon = self.left.clamp(max=env.control_dt)[:, None] / env.mass  # as KneelReference sees it
        for rows in torch.arange(count).split(env.num_envs):  # the last ones are filled up
            td = self.begin(torch.cat([rows, rows.new_zeros(env.num_envs - len(rows))]))
            speed = td["com_velocity"][: len(rows), :2] + soon[rows] * self.force[rows, :2]
            velocity[rows] = turn_to_heading(td["base_orientation"][: len(rows)], speed)
        self.speed = velocity.norm(dim=-1)
        self.heading = torch.atan2(velocity[:, 1], velocity[:, 0]).rad2deg()

    def wrench(self, rows: Tensor, time: float) -> Tensor | None:
        """What is left of their pushes in the control step that begins at a time [s]."""
        env = self.env
        steps = ((self.left[rows] - time) / env.physics_dt).round()
        if not (steps > 0).any():
            return None
        on = torch.arange(env.substeps) < steps[:, None]
        wrench = torch.zeros(len(rows), env.substeps, env.num_bodies, 6)
        wrench[:, :, env.push_targets["torso"], :3] = on[..., None] * self.force[rows, None]
        return wrench

    def begin(self, rows: Tensor) -> TensorDict:
        """Worlds ``(N,)`` in the falls of these rows."""
        start = TensorDict({key: value[rows] for key, value in self.states.items()}, [len(rows)])
        return self.env.reset(TensorDict({"start": start}, [len(rows)]))

    def like(self, heading: float, low: float, high: float) -> Tensor:
        """Rows of falls within 15 degrees of a heading and between two speeds [m/s]."""
        off = (self.heading - heading + 180.0) % 360.0 - 180.0
        return ((off.abs() <= 15.0) & (self.speed >= low) & (self.speed < high)).nonzero()[:, 0]


class Landing(NamedTuple):
    """How falls ended, each ``(N,)``.

    safe: at rest, torso and head never on the floor.
    kneels: in a ``resting_kneel``, torso and head never on the floor.
    lasted: share of the time until one of them first touched it.
    upright: cosine of the tilt at the end, 0 if one of them ever did.
    force: largest of the floor on torso or head [N].
    acceleration: largest of the base [m/s2].
    """

    safe: Tensor
    kneels: Tensor
    lasted: Tensor
    upright: Tensor
    force: Tensor
    acceleration: Tensor

    @property
    def score(self) -> Tensor:
        """How good it is ``(N,)``, at most 9."""
        soft = 2.0 - (self.force / FORCE).clamp(max=1.0) * 2.0
        soft += 2.0 - (self.acceleration / ACCELERATION).clamp(max=1.0) * 2.0
        return self.safe.float() + 2.0 * self.kneels.float() + self.lasted + self.upright + soft


def caught(falls: Falls, rows: Tensor, postures: Tensor, until: Tensor) -> Landing:
    """What becomes of falls with movements ``(N, K, J)``, each on its own."""
    env, count = falls.env, len(rows)
    falls.begin(rows)
    way = env.stand_position.repeat(count, 1)
    reach = SPEED * env.control_dt
    struck = [env.regions.index(region) for region in ("torso", "head")]
    lasted, force, acceleration = torch.zeros(3, count)
    since, steps = torch.zeros(count), round(END / env.control_dt)
    for step in range(steps):
        phase = int((until <= step * env.control_dt + 1e-6).sum())
        way = way + (postures[:, phase] - way).clamp(-reach, reach)
        td = TensorDict({"target": way}, batch_size=[count])
        wrench = falls.wrench(rows, step * env.control_dt)
        if wrench is not None:
            td["push", "wrench"] = wrench
        td = env.step(td)["next"]
        counted, diverged = since < AFTER, td["diverged"].squeeze(-1)
        hit = td["contact_force_peak"][:, struck].amax(-1).masked_fill(diverged, FORCE)
        shock = td["base_acceleration_peak"][:, 0].masked_fill(diverged, ACCELERATION)
        force = torch.where(counted, torch.maximum(force, hit), force)
        acceleration = torch.where(counted, torch.maximum(acceleration, shock), acceleration)
        touched = (since > 0) | (force > 0)
        since += touched * env.control_dt
        lasted += ~touched / steps
        env.simulation.step_only(since < AFTER)
        if not (since < AFTER).any():
            break
    env.simulation.step_only(None)
    still = td["base_linear_velocity"].norm(dim=-1) < 0.1
    still &= td["base_angular_velocity"].norm(dim=-1) < 0.1
    kneels = resting_kneel(td, td, robot=env.robot).squeeze(-1)
    untouched = since == 0.0
    upright = untouched * -td["projected_gravity"][:, 2]
    return Landing(untouched & still, untouched & kneels, lasted, upright, force, acceleration)


def outcome(falls: Falls, rows: Tensor, move: Tensor, until: Tensor) -> tuple[float, str]:
    """Mean score of one movement ``(K, J)`` on all these falls, and what becomes of them."""
    some = rows[torch.arange(falls.env.num_envs) % len(rows)]
    landing = caught(falls, some, move.expand(len(some), -1, -1), until)
    kneels, force = landing.kneels.float().mean(), landing.force.mean()
    text = f"{kneels:.2f} kneel, mean {force:.0f} N, {landing.acceleration.mean():.0f} m/s2"
    return landing.score.mean().item(), text


def search(falls: Falls, rows: Tensor, mean: Tensor, cfg: DictConfig) -> Tensor:
    """The mean of the best movements ``(K, J)`` [rad].

    Args:
        falls: all of them.
        rows: those to be caught.
        mean: where the search begins ``(K, J)`` [rad].
        cfg: of the recipe.
    """
    generator = torch.Generator().manual_seed(cfg.seed)
    low, high = falls.env.joint_range.unbind(-1)
    until = torch.tensor([*cfg.until, torch.inf])
    std, kept = torch.full_like(mean, cfg.spread), mean[None]
    for _ in range(cfg.rounds):
        noise = torch.randn((cfg.candidates, *mean.shape), generator=generator)
        moves = (mean + std * noise).clamp(low, high)
        moves[: len(kept)] = kept
        tried = rows[torch.randint(len(rows), (cfg.trials,), generator=generator)]
        landing = caught(
            falls, tried.repeat(cfg.candidates), moves.repeat_interleave(cfg.trials, 0), until
        )
        best = landing.score.view(cfg.candidates, cfg.trials).mean(1).topk(cfg.elite)
        kept = moves[best.indices]
        mean, std = kept.mean(0), 0.9 * kept.std(0) + 0.02
    return mean


@hydra.main(version_base=None, config_path=".", config_name="catches")
def main(cfg: DictConfig) -> None:
    """Writes ``catches.npz`` and what came of each movement on all its falls."""
    console = Console()
    with one_line_errors():
        check_keys(cfg, KEYS)
        check_lists(cfg, ("headings", "until", "speeds"))
        check_whole(cfg, ("candidates", "trials", "elite", "rounds"), 1)
        check_whole(cfg, ["seed"])
        check_number(cfg.spread, "spread", lambda x: 0 < x < math.inf, "be positive and finite")
        if not 2 <= cfg.elite <= cfg.candidates:
            raise ValueError(f"elite must lie in [2, candidates], got {cfg.elite}.")
        if not cfg.headings or any(heading not in HEADINGS for heading in cfg.headings):
            raise ValueError(
                f"headings must be some of 0, 30, ... 330 degrees, got {cfg.headings}."
            )
        for name in ("until", "speeds"):
            if sorted(cfg[name]) != list(cfg[name]):
                raise ValueError(f"{name} must rise, got {list(cfg[name])}.")
        num_envs = cfg.candidates * cfg.trials
        env = HumanoidEnv(num_envs=num_envs, control_dt=0.04, physics_dt=0.004)
        falls = Falls(env, Path(cfg.falls))
    until = torch.tensor([*cfg.until, torch.inf])
    edges = [0.0, *cfg.speeds, torch.inf]
    known = load_catches(env.robot) if catches_path(env.robot).is_file() else None
    bins = list(enumerate(pairwise(edges)))
    found = env.stand_position.repeat(len(HEADINGS), len(bins), len(until), 1)
    if known is not None:
        of_bin = torch.arange(len(bins)).clamp(max=known.postures.shape[1] - 1)
        of_time = torch.arange(len(until)).clamp(max=known.postures.shape[2] - 1)
        found[:] = known.postures[:, of_bin][:, :, of_time]
    path = Path(HydraConfig.get().runtime.output_dir) / "catches.npz"
    save_catches(path, found, until, torch.tensor(list(cfg.speeds)))
    for heading, (j, (low, high)) in product(cfg.headings, bins):
        i = HEADINGS.index(heading)
        rows = falls.like(heading, low, high)
        if len(rows) < cfg.trials:
            console.print(f"{heading} degrees, from {low} m/s: {len(rows)} falls, left as is")
            continue
        before = outcome(falls, rows, found[i, j], until)
        move = search(falls, rows, found[i, j], cfg)
        after = outcome(falls, rows, move, until)
        better = after[0] > before[0]
        if better:
            found[i, j] = move
            save_catches(path, found, until, torch.tensor(list(cfg.speeds)))
        console.print(
            f"{heading} degrees, from {low} m/s: {len(rows)} falls, "
            f"before {before[1]}; after {after[1]}{'' if better else ', left as is'}",
            soft_wrap=True,
        )
    console.print(f"wrote {path}", soft_wrap=True)


if __name__ == "__main__":
    start(main)
