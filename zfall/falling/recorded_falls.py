"""Recorded falls that go on without a policy, and how they end."""

import math
from pathlib import Path
from typing import NamedTuple

import torch
from tensordict import TensorDict
from torch import Tensor

from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.mirror import mirror_quantity
from zfall.falling.bank_worlds import BankWorlds
from zfall.falling.banks import PUSH_KEYS, load_bank
from zfall.falling.kneel_reference import SETTLE
from zfall.falling.terms import resting_kneel
from zfall.rotations import turn_to_heading

END, SPEED = 1.5, 6.0  # of a trial [s]; of each joint, as that of KneelReference [rad/s]
AFTER = 0.5  # for which a trial goes on once torso or head touched [s], as in battery planar
FORCE, ACCELERATION = 1200.0, 400.0  # worst that a score tells apart [N, m/s2]


def last_choice(control_dt: float) -> float:
    """When ``KneelReference`` chooses its movement for the last time, after the first [s]."""
    return (math.ceil(SETTLE / control_dt - 1e-6) - 1) * control_dt


class Falls:
    """Falls of a bank, with which worlds begin.

    Attributes:
        speed: of the center of mass along the ground, after what of the push acts until
            ``KneelReference`` chooses its movement for the last time ``(K,)`` [m/s].
        heading: its direction, from the robot's own, counterclockwise ``(K,)`` [degrees]; of a fall
            that is mirrored as in the mirror.
        mirrored: falls that are caught by the mirror image of a movement ``(K,)`` bool.

    Args:
        worlds: which begin in them.
        path: of the bank, which must have pushes, at the torso.
        mirrored: whether falls to the left are, as ``MirroredFalls`` has it.

    Raises:
        ValueError: if there is no such bank.
    """

    def __init__(self, worlds: BankWorlds, path: Path, *, mirrored: bool = False):
        self.worlds, self.env = worlds, worlds.base
        bank = load_bank(path, self.env.robot, needs=PUSH_KEYS, name="falls")
        keys = [key for key in (*STATE_KEYS, "target") if key in bank]
        self.states = {key: bank[key] for key in keys}
        self.force, self.left = bank["push_force"], bank["push_left"][:, 0]
        env, count = self.env, len(self.force)
        velocity, self.mirrored = torch.empty(count, 2), torch.zeros(count, dtype=torch.bool)
        soon = self.left.clamp(max=last_choice(env.control_dt))[:, None] / env.mass
        for rows in torch.arange(count).split(env.num_envs):  # the last ones are filled up
            td = self.begin(torch.cat([rows, rows.new_zeros(env.num_envs - len(rows))]))
            now, ahead = td["com_velocity"][: len(rows), :2], td["base_orientation"][: len(rows)]
            velocity[rows] = turn_to_heading(ahead, now + soon[rows] * self.force[rows, :2])
            self.mirrored[rows] = mirrored & (turn_to_heading(ahead, now)[:, 1] > 0)
        velocity[:, 1] = torch.where(self.mirrored, -velocity[:, 1], velocity[:, 1])
        self.speed = velocity.norm(dim=-1)
        self.heading = torch.atan2(velocity[:, 1], velocity[:, 0]).rad2deg()

    def wrench(self, rows: Tensor, time: float) -> Tensor | None:
        """The rest of the pushes in the control step that begins at a time [s].

        Returns:
            ``(N, S, bodies, 6)`` [N, N m; world]; ``None`` if no push acts any more.
        """
        env = self.env
        steps = ((self.left[rows] - time) / env.physics_dt).round()
        if not (steps > 0).any():
            return None
        on = torch.arange(env.substeps) < steps[:, None]
        wrench = torch.zeros(len(rows), env.substeps, env.num_bodies, 6)
        wrench[:, :, env.push_targets["torso"], :3] = on[..., None] * self.force[rows, None]
        return wrench

    def begin(self, rows: Tensor) -> TensorDict:
        """Resets the worlds into the falls of these rows ``(N,)``."""
        return self.worlds.begin(self.states, rows)

    def like(self, heading: float, low: float, high: float) -> Tensor:
        """Rows of falls within 15 degrees of a heading and between two speeds [m/s]."""
        off = (self.heading - heading + 180.0) % 360.0 - 180.0
        return ((off.abs() <= 15.0) & (self.speed >= low) & (self.speed < high)).nonzero()[:, 0]


class Landing(NamedTuple):
    """How falls ended, each ``(N,)``.

    Attributes:
        safe: at rest, torso and head never on the floor, bool.
        kneels: in a ``resting_kneel``, torso and head never on the floor, bool.
        lasted: share of the time until one of them first touched it.
        upright: cosine of the tilt at the end, 0 if one of them ever touched.
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
    """How falls end whose joints go through the postures of a movement.

    Args:
        falls: of a bank.
        rows: fall of each world ``(N,)``.
        postures: movement of each world ``(N, K, J)`` [rad]; of mirrored falls in the mirror.
        until: when each posture ends ``(K,)`` [s].
    """
    env, count = falls.env, len(rows)
    falls.begin(rows)
    index, sign = mirror_quantity(env.robot, "target")
    image = postures[..., list(index)] * torch.tensor(sign)
    postures = torch.where(falls.mirrored[rows, None, None], image, postures)
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
        td = falls.worlds.env.step(td)["next"]
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
