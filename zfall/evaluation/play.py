"""How far a policy gets in its task, and what a film of it shows."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import TransformedEnv

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.evaluation.battery import play
from zfall.evaluation.captions import Pushed, PushLog
from zfall.evaluation.endings import Endings
from zfall.evaluation.followers import Follower
from zfall.evaluation.video import Cut, Outcomes, film, frame
from zfall.rotations import turn_to_heading

FIRST, APART, DURATION = 1.0, 4.0, 0.1  # when pushes begin, and their length [s]
UNITS = {"seconds": "s", "forward_velocity": "m/s", "distance": "m"}


@dataclass(frozen=True)
class Played:
    """What came of playing.

    Attributes:
        figures: ``worlds``; ``fell``, in how many of them a region but the feet touched the floor;
            ``ended``, in how many the task ended without that; by the names of the followers'
            outcomes, how many end so; ``seconds``, mean time to either;
            ``forward_velocity`` [m/s], mean over that time of the base's velocity along the way
            the robot faces; ``distance`` [m], mean from begin to end of it, on the level.
        states: positions of the first worlds ``(T, filmed, nq)``, in MuJoCo's order.
        pushed: what pushed them, from state to state.
        outcomes: what came of each of them.
    """

    figures: dict[str, float]
    states: NDArray[np.float64]
    pushed: Pushed
    outcomes: list[Outcomes]

    def lines(self) -> list[str]:
        """The figures in words, with units; counts are of all worlds."""
        worlds = f"{self.figures['worlds']:.0f}"
        counted = [key for key in self.figures if key not in (*UNITS, "worlds")]
        counts = [f"{key}: {self.figures[key]:.0f} of {worlds} worlds" for key in counted]
        return counts + [f"{key}: {self.figures[key]:.3g} {unit}" for key, unit in UNITS.items()]


def planned(
    env: TransformedEnv, pushes: float | Sequence[float] | None, apart: float | None
) -> tuple[list[float] | None, float]:
    """Sizes of pushes and the time from push to push [s].

    ``None`` stands for what a transform of the env says in ``played_with``, its size and time: a
    task that shows nothing unless the robot falls. Else it is no push, and 4 s.

    Args:
        env: the task.
        pushes: a size, or one for each push; 0: none.
        apart: [s].

    Returns:
        Sizes, ``None`` for no pushes; time.
    """
    shown = next((t.played_with for t in env.transform if hasattr(t, "played_with")), None)
    if pushes is None and shown and ("push", "force") not in env.observation_spec.keys(True):
        pushes = shown[0]
    apart = apart or (shown[1] if shown else APART)
    if pushes is None or pushes == 0:
        return None, apart
    return [*pushes] if isinstance(pushes, Sequence) else [pushes], apart


def side_pushes(
    env: TransformedEnv, sizes: Sequence[float], seconds: float, apart: float = APART
) -> ScriptedPush:
    """Pushes at the torso, from 1 s on, each from the next side.

    World 0 is pushed from behind, from the right, from the front and from the left; worlds 1 to 3
    begin with the other sides, and later worlds lie between them.

    Args:
        env: the task, which has no push of its own.
        sizes: impulses I of the pushes; one alone is repeated until the end.
        seconds: length of the episode [s].
        apart: time from the begin of a push to that of the next [s].

    Raises:
        ValueError: if the task pushes by itself, without sizes, or if the last comes too late.
    """
    if ("push", "force") in env.observation_spec.keys(True):
        raise ValueError("pushes must be null or 0 where keep leaves a push of the task on.")
    if not sizes:
        raise ValueError("pushes must hold at least one size, got [].")
    last = FIRST + apart * (len(sizes) - 1)
    if seconds <= last:
        raise ValueError(
            f"seconds must be above {last:g}, when the last of pushes comes, got {seconds}."
        )
    base = env.base_env
    if len(sizes) == 1:
        sizes = list(sizes) * math.ceil((seconds - FIRST) / apart)
    world = torch.arange(env.num_envs)[:, None]
    begin = math.pi / 2 * (world % 4 + (world // 4) / math.ceil(env.num_envs / 4))
    heading = begin + math.pi / 2 * torch.arange(len(sizes))
    force = torch.tensor(sizes) * base.robot.impulse_unit / DURATION
    level = torch.stack([heading.cos(), heading.sin(), torch.zeros_like(heading)], -1)
    return ScriptedPush(
        base,
        point=["torso"] * len(sizes),
        duration=DURATION,
        time=[FIRST + apart * k for k in range(len(sizes))],
        plan=force[:, None] * level,
    )


def walk(
    env: TransformedEnv,
    actor: torch.nn.Module | None,
    seconds: float,
    *,
    filmed: int = 4,
    followers: Sequence[type[Follower]] = (),
    follow: Callable[[Iterable[TensorDictBase], int], Iterable[TensorDictBase]] = (
        lambda steps, total: steps
    ),
) -> Played:
    """Lets a policy act in its task from a fresh reset, without exploration.

    Args:
        env: the task, of whole blocks of 64 worlds.
        actor: the policy; ``None`` holds the reference pose.
        seconds: time to play [s].
        filmed: of how many worlds the states are kept.
        followers: whose outcomes are looked for, as a battery's ``measures`` name them.
        follow: passes the steps on, given their number, as a progress bar does.
    """
    base = env.base_env
    steps, every = round(seconds / base.control_dt), round(frame(base) / base.control_dt)
    endings, log = Endings(base, followers), PushLog(filmed)
    began = last = torch.zeros(0)
    upright, ways = torch.zeros(env.num_envs), torch.zeros(env.num_envs)
    states, ends = [], []
    for step, td in enumerate(follow(play(env, actor, steps), steps)):
        place = td["base_position"][:, :2]
        if step == 0:
            began = last = place
        endings.update(td, (step + 1) * base.control_dt)
        way = turn_to_heading(td["base_orientation"], td["base_linear_velocity"][:, :2])[:, 0]
        ways += way * endings.up
        upright += endings.up
        last = torch.where(endings.up[:, None], place, last)
        log.add(td)
        if (step + 1) % every == 0 or step + 1 == steps:
            states.append(base.simulation.qpos[:filmed].numpy().copy())
            ends.append(step + 1)
    figures = {
        "worlds": float(env.num_envs),
        "fell": float(endings.fell.sum()),
        "ended": float((~endings.up & ~endings.fell).sum()),
        **{name: float(which.sum()) for name, which in endings.reached.items()},
        "seconds": float(upright.mean()) * base.control_dt,
        "forward_velocity": float((ways / upright.clamp_min(1)).mean()),
        "distance": float((last - began).norm(dim=-1).mean()),
    }
    outcomes = [endings.said(world, seconds) for world in range(filmed)]
    return Played(figures, np.stack(states), log.frames(ends), outcomes)


def film_of(
    played: Played,
    base: HumanoidEnv,
    label: str,
    path: Path,
    *,
    cut: Cut = Cut(),
    follow: Callable[[Iterable[int], int], Iterable[int]] = lambda frames, total: frames,
) -> None:
    """Films what was played, one column per world.

    Args:
        played: by ``walk``.
        base: the env in which.
        label: of who played.
        path: of the mp4.
        cut: which part of the time is shown, and how fast.
        follow: passes the frames on, given their number, as a progress bar does.

    Raises:
        RuntimeError: if no OpenGL is to be had.
    """
    film(
        base.camera.model,
        {label: played.states},
        [f"world {i}" for i in range(played.states.shape[1])],
        played.pushed,
        path,
        dt=frame(base),
        cut=cut,
        outcomes={label: played.outcomes},
        follow=follow,
    )
