"""How far a policy gets in its task, and what a film of it shows."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from zfall.evaluation.battery import play
from zfall.evaluation.video import frame

FILMED = 4  # worlds


@dataclass(frozen=True)
class Played:
    """What came of playing.

    Attributes:
        figures: ``worlds``; ``fell``, how many of them did within the time; ``seconds``, mean time
            that they stood or walked; ``forward_velocity`` [m/s], mean over that time of the
            base's velocity along the way the robot faces; ``distance`` [m], mean from begin to end
            of it, on the level.
        states: positions of the first four worlds ``(T, 4, nq)``, in MuJoCo's order.
        forces: of pushes on them ``(T, 4, 3)`` [N; world].
    """

    figures: dict[str, float]
    states: NDArray[np.float64]
    forces: NDArray[np.float32]


def walk(
    env: TransformedEnv,
    actor: torch.nn.Module | None,
    seconds: float,
    *,
    follow: Callable[[Iterable[TensorDictBase], int], Iterable[TensorDictBase]] = (
        lambda steps, total: steps
    ),
) -> Played:
    """Lets a policy act in its task from a fresh reset, without exploration.

    Args:
        env: the task, of whole blocks of 64 worlds.
        actor: the policy; ``None`` holds the reference pose.
        seconds: time to play [s].
        follow: passes the steps on, given their number, as a progress bar does.
    """
    base = env.base_env
    steps, every = round(seconds / base.control_dt), round(frame(base) / base.control_dt)
    up = torch.ones(env.num_envs, dtype=torch.bool)
    began = last = torch.zeros(0)
    upright, ways = torch.zeros(env.num_envs), torch.zeros(env.num_envs)
    states, forces = [], []
    for step, td in enumerate(follow(play(env, actor, steps), steps)):
        place = td["base_position"][:, :2]
        if step == 0:
            began = last = place
        up = up & ~td["terminated"][:, 0]
        w, x, y, z = td["base_orientation"].unbind(-1)
        heading = torch.atan2(2 * (w * z + x * y), 1 - 2 * (y.square() + z.square()))
        facing = torch.stack([heading.cos(), heading.sin()], -1)
        way = (td["base_linear_velocity"][:, :2] * facing).sum(-1)
        ways += way * up
        upright += up
        last = torch.where(up[:, None], place, last)
        if step % every == 0:
            states.append(base.simulation.qpos[:FILMED].numpy().copy())
            push = td.get(("push", "force"), torch.zeros(FILMED, 3))
            forces.append(push[:FILMED].numpy().copy())
    figures = {
        "worlds": float(env.num_envs),
        "fell": float((~up).sum()),
        "seconds": float(upright.mean()) * base.control_dt,
        "forward_velocity": float((ways / upright.clamp_min(1)).mean()),
        "distance": float((last - began).norm(dim=-1).mean()),
    }
    return Played(figures, np.stack(states), np.stack(forces))
