"""Searches movements that get up, in the twin: tried from many starts, each with its own draw."""

from pathlib import Path
from typing import NamedTuple

import torch
from torch import Tensor

from zfall.envs.humanoid import STATE_KEYS
from zfall.falling.bank_worlds import BankWorlds
from zfall.falling.lying import load_lying
from zfall.falling.rises import GOALS, Rises
from zfall.falling.search import CrossEntropySearch
from zfall.falling.standing import stands

AFTER = 0.8  # time after the last keyframe in which a movement shows what it is worth [s]
LAST = 0.4  # the end of it, which counts [s]
FORCE = 1200.0  # worst that a score tells apart, as in ``recorded_falls`` [N]


class Rose(NamedTuple):
    """What came of movements, each ``(N,)``.

    Attributes:
        reached: the goal at the end: standing, or on the belly; bool.
        near: how near it came, at most 2: height and uprightness, or how far it lies on the belly.
        force: largest of the floor on torso or head [N].
        torque: largest of a joint [N m].
    """

    reached: Tensor
    near: Tensor
    force: Tensor
    torque: Tensor

    @property
    def score(self) -> Tensor:
        """How good it is ``(N,)``, at most 5."""
        soft = 1.0 - (self.force / FORCE).clamp(max=1.0)
        return 2.0 * self.reached.float() + self.near + soft


class LyingWorlds:
    """Worlds of the twin that begin in the states of a bank.

    Args:
        count: number of worlds.
        bank: file of ``recipes.falling.lying``.
        seed: of the draws of the twin.
        control_dt: of the policy that rises [s].

    Raises:
        ValueError: if there is no such bank.
    """

    def __init__(self, count: int, bank: Path, *, seed: int = 0, control_dt: float = 0.04):
        self.worlds = BankWorlds(count, "twin", control_dt=control_dt)
        self.env, self.base = self.worlds.env, self.worlds.base
        self.bank = load_lying(self.base.robot, bank)
        self.env.set_seed(seed)

    def rows(self, rises: Rises, number: int) -> Tensor:
        """Rows of the bank for which a movement would be chosen ``(K,)``."""
        chosen = rises.choose(self.bank["posture"], self.bank["joint_position"])
        return (chosen == number).nonzero()[:, 0]

    def rise(self, rows: Tensor, moves: Tensor, ends: Tensor, goal: str) -> Rose:
        """What comes of movements that begin in rows of the bank.

        Args:
            rows: ``(N,)``.
            moves: keyframes of each world ``(N, K, J)`` [rad].
            ends: when they are reached ``(K,)`` [s].
            goal: ``stand`` or ``belly``.
        """
        base, count = self.base, len(rows)
        td = self.worlds.begin({key: self.bank[key] for key in (*STATE_KEYS, "target")}, rows)
        begin, each = self.bank["target"][rows], torch.arange(count)
        none = torch.empty(0)
        rises = Rises((), none, none, none, moves, ends.expand(count, -1))
        struck = [base.regions.index(region) for region in ("torso", "head")]
        force, torque, near = torch.zeros(3, count)
        reached, failed = torch.ones(count, dtype=torch.bool), torch.zeros(count, dtype=torch.bool)
        steps = round((float(ends[-1]) + AFTER) / base.control_dt)
        for step in range(steps):
            time = torch.full((count,), (step + 1) * base.control_dt)
            td["target"] = rises.target(each, begin, time)
            td = self.env.step(td)["next"]
            failed |= td["diverged"].squeeze(-1)
            force = torch.maximum(force, td["contact_force_peak"][:, struck].amax(-1))
            torque = torch.maximum(torque, td["joint_torque"].abs().amax(-1))
            if step < steps - round(LAST / base.control_dt):
                continue
            down = td["projected_gravity"]
            if goal == "stand":
                height = td["com_position"][:, 2] / base.robot.com_height
                near += height.clamp(max=1.0) - down[:, 2]
                reached &= stands(td, base.robot)
            else:
                near += 1.0 + down[:, 0]
                reached &= down[:, 0] > 0.9
        near /= round(LAST / base.control_dt)
        return Rose(reached & ~failed, torch.where(failed, 0.0, near), force, torque)


def search_rise(
    worlds: LyingWorlds, rises: Rises, name: str, search: CrossEntropySearch
) -> tuple[Rose, Rose]:
    """Searches one of the movements, and keeps the known one unless the new one is better.

    Args:
        worlds: ``candidates * trials`` of them.
        rises: whose keyframes are replaced.
        name: of the movement.
        search: what looks for it.

    Returns:
        What comes of the movement known before and of that found, over starts of the bank.

    Raises:
        ValueError: if the bank has no start for it.
    """
    number = rises.names.index(name)
    rows, goal = worlds.rows(rises, number), GOALS[rises.goal[number]]
    if not len(rows):
        raise ValueError(f"bank must have starts for {name}, got none.")
    known, ends = rises.keyframes[number], rises.ends[number]

    def score(tried: Tensor, moves: Tensor) -> Tensor:
        return worlds.rise(tried, moves, ends, goal).score

    found = search(score, rows, known, worlds.base.joint_range)
    some = rows[torch.arange(worlds.base.num_envs) % len(rows)]
    before, after = (
        worlds.rise(some, move.expand(len(some), -1, -1), ends, goal) for move in (known, found)
    )
    if after.score.mean() > before.score.mean():
        rises.keyframes[number] = found
    return before, after
