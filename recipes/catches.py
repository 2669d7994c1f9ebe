"""Looks for movements that catch a fall: ``python -m recipes.catches falls=FILE``.

For each of twelve headings and some speeds, falls that ``recipes.falls`` recorded after pushes at
the torso go on with the joints going through a few postures, without a policy. The best of many
movements are kept and varied, again and again (cross-entropy method, Rubinstein 1999), each tried
on other falls every time. Good is what comes to rest with torso and head never on the floor,
better upright on a knee or shin. Goes on from what the robot has, and keeps that where it is
better; takes half an hour.
"""

from itertools import pairwise, product
from pathlib import Path

import hydra
import numpy as np
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from rich.console import Console
from tensordict import TensorDict
from torch import Tensor

from recipes.one_line import check_keys, one_line_errors, start
from zfall.envs.catches import HEADINGS, catches_path, load_catches, save_catches
from zfall.envs.humanoid import STATE_KEYS, HumanoidEnv
from zfall.envs.rotations import turn_to_heading
from zfall.envs.terms.kneel import resting_kneel, touching

END, SPEED = 1.5, 6.0  # of a trial [s]; of each joint, as that of KneelReference [rad/s]
KEYS = {"falls", "speeds", "until", "candidates", "trials", "elite", "rounds", "spread", "seed"}


class Falls:
    """Recorded falls, with which worlds begin.

    Args:
        env: the base env.
        path: the file.
    """

    def __init__(self, env: HumanoidEnv, path: Path):
        if not path.is_file():
            raise ValueError(f"falls must be a file that recipes.falls wrote, there is no {path}.")
        with np.load(path) as file:
            arrays = {key: torch.from_numpy(file[key]).float() for key in file.files}
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
        wrench = env.zero_wrench()
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


def caught(falls: Falls, rows: Tensor, postures: Tensor, until: Tensor) -> tuple[Tensor, ...]:
    """Of movements ``(N, K, J)``, each on its fall: at rest, kneeling, untouched, upright.

    The third is the share of the time until torso or head first touched the floor; the others are
    at the end, and count for nothing if they ever did. The last is the cosine of the tilt.
    """
    env = falls.env
    falls.begin(rows)
    way = env.stand_position.repeat(len(rows), 1)
    reach = SPEED * env.control_dt
    untouched = torch.ones(len(rows), dtype=torch.bool)
    lasted, steps = torch.zeros(len(rows)), round(END / env.control_dt)
    for step in range(steps):
        phase = int((until <= step * env.control_dt + 1e-6).sum())
        way = way + (postures[:, phase] - way).clamp(-reach, reach)
        td = TensorDict({"target": way}, batch_size=[len(rows)])
        wrench = falls.wrench(rows, step * env.control_dt)
        if wrench is not None:
            td["push", "wrench"] = wrench
        td = env.step(td)["next"]
        untouched &= ~(touching(td, env.robot, "torso", "head") | td["diverged"]).squeeze(-1)
        lasted += untouched / steps
        env.simulation.step_only(untouched)
        if not untouched.any():
            break
    env.simulation.step_only(None)
    still = td["base_linear_velocity"].norm(dim=-1) < 0.1
    still &= td["base_angular_velocity"].norm(dim=-1) < 0.1
    kneels = resting_kneel(td, td, robot=env.robot).squeeze(-1)
    upright = untouched * -td["projected_gravity"][:, 2]
    return untouched & still, untouched & kneels, lasted, upright


def score(safe: Tensor, kneels: Tensor, lasted: Tensor, upright: Tensor) -> Tensor:
    """How good an outcome is, at most 5."""
    return safe.float() + 2.0 * kneels.float() + lasted + upright


def outcome(falls: Falls, rows: Tensor, move: Tensor, until: Tensor) -> tuple[float, float]:
    """Mean score, and share of kneels, of one movement ``(K, J)`` on all these falls."""
    some = rows[torch.arange(falls.env.num_envs) % len(rows)]
    results = caught(falls, some, move.expand(len(some), -1, -1), until)
    return score(*results).mean().item(), results[1].float().mean().item()


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
        results = caught(
            falls, tried.repeat(cfg.candidates), moves.repeat_interleave(cfg.trials, 0), until
        )
        best = score(*results).view(cfg.candidates, cfg.trials).mean(1).topk(cfg.elite)
        kept = moves[best.indices]
        mean, std = kept.mean(0), 0.9 * kept.std(0) + 0.02
    return mean


@hydra.main(version_base=None, config_path=".", config_name="catches")
def main(cfg: DictConfig) -> None:
    """Writes ``catches.npz`` and what came of each movement on all its falls."""
    console = Console()
    with one_line_errors():
        check_keys(cfg, KEYS)
        if not 2 <= cfg.elite <= cfg.candidates:
            raise ValueError(f"elite must lie in [2, candidates], got {cfg.elite}.")
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
    for (i, heading), (j, (low, high)) in product(enumerate(HEADINGS), bins):
        rows = falls.like(heading, low, high)
        if len(rows) < cfg.trials:
            console.print(f"{heading} degrees, from {low} m/s: {len(rows)} falls, left as is")
            continue
        before = outcome(falls, rows, found[i, j], until)
        move = search(falls, rows, found[i, j], cfg)
        after = outcome(falls, rows, move, until)
        if after[0] > before[0]:
            found[i, j] = move
            save_catches(path, found, until, torch.tensor(list(cfg.speeds)))
        console.print(
            f"{heading} degrees, from {low} m/s: {len(rows)} falls, "
            "kneeling {:.2f} before, {:.2f} after".format(before[1], after[1]),
            soft_wrap=True,
        )
    console.print(f"wrote {path}")


if __name__ == "__main__":
    start(main)
