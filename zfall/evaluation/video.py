"""Films of trials: a row for each policy, a column for each push."""

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import mujoco
import numpy as np
from numpy.typing import NDArray

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.rendering import make_renderer, place
from zfall.evaluation.captions import (
    MARKED,
    Mark,
    Pushed,
    outcome_at,
    push_marks,
    write_on,
    write_push,
)

RATE = 25.0  # least pictures per second
# Time [s], words, whether it is good, or neither. {when} in the words is the time since the push.
Outcomes = Sequence[tuple[float, str, bool | None]]


@dataclass(frozen=True)
class Cut:
    """Which part of the time a film shows, and how fast.

    Args:
        slow: how fast time goes, 0.25 for four times as slow.
        slow_for: so long from the begin of each push [s]; ``None``: all the time.
        shown: from when to when [s]; ``None``: from begin to end.

    Raises:
        ValueError: if ``slow`` is not in (0, 1], or 1 with ``slow_for``.
    """

    slow: float = 1.0
    slow_for: float | None = None
    shown: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if not 0 < self.slow <= 1:
            raise ValueError(f"slow must be above 0 and at most 1, got {self.slow}.")
        if self.slow_for is not None and self.slow == 1:
            raise ValueError(f"slow must be below 1 with slow_for={self.slow_for:g}, got 1.")

    def check(self, end: float) -> None:
        """Refuses to show what comes after the end [s].

        Raises:
            ValueError: as it says.
        """
        if self.shown is not None and not self.shown[0] < end:
            raise ValueError(f"shown must begin before the end, {end:g} s, got {self.shown[0]:g}.")

    def pictures(
        self, count: int, dt: float, start: float, begins: Iterable[float], rate: float
    ) -> list[tuple[float, float]]:
        """Time since the first state and pace of each picture.

        Args:
            count: number of states; the last stays for ``dt``.
            dt: time between two of them [s].
            start: time of the first [s].
            begins: of pushes [s].
            rate: of the film [1/s].

        Raises:
            ValueError: if there are none.
        """
        begins = list(begins)
        first, end = self.shown or (start, math.inf)
        moment, last = max(0.0, first - start), min(count * dt, end - start)
        out = []
        while moment < last - 1e-6:
            ages = [start + moment - begin for begin in begins]
            slowly = self.slow_for is None or any(-1e-6 <= a < self.slow_for - 1e-6 for a in ages)
            pace = self.slow if slowly else 1.0
            out.append((moment, pace))
            moment = round(moment + pace / rate, 9)
        if not out:
            there = f"{start:g} to {start + count * dt:g} s"
            raise ValueError(
                f"shown must hold some of the time from {there}, got [{first:g}, {end:g}]."
            )
        return out


def film(
    model: mujoco.MjModel,
    rows: dict[str, NDArray[np.float64]],
    columns: list[str],
    pushed: Pushed,
    path: Path,
    *,
    dt: float,
    start: float | None = None,
    tile: tuple[int, int] = (640, 480),
    cut: Cut = Cut(),
    outcomes: Mapping[str, Sequence[Outcomes]] | None = None,
    shadows: bool = True,
    follow: Callable[[Iterable[int], int], Iterable[int]] = lambda frames, total: frames,
) -> None:
    """Writes an mp4 of a grid: one row per policy, one column per push.

    A single row of more than two columns takes two lines, a single column of two rows one line. An
    arrow marks a push for a second, but on no robot that has fallen; a line of text names it once,
    as the first row's robot sees it. A clock runs in the upper right corner.

    Args:
        model: of what is shown, as ``env.camera.model``.
        rows: by name of the policy, positions ``(T, columns, nq)`` in MuJoCo's order.
        columns: name of each column's push.
        pushed: what pushes each column, over the T times.
        path: file to write.
        dt: time between two states [s].
        start: time of the first state [s]; ``None``: ``dt``, as states follow their control steps.
        tile: width and height of one picture [pixels].
        cut: which part of the time, and how fast.
        outcomes: by name of the policy, what came of each column, and when.
        shadows: whether there are any; without them a picture takes a third of the time.
        follow: passes on the numbers of the pictures, as a progress bar does.

    Raises:
        RuntimeError: if no OpenGL is to be had.
        ValueError: if nothing is left to show.
    """
    start = dt if start is None else start
    renderer = make_renderer(model, *tile)
    option = mujoco.MjvOption()
    option.sitegroup[:] = 0
    data = mujoco.MjData(model)
    marks = {
        (name, c): push_marks(pushed, c, _headings(states[:, c]), dt)
        for name, states in rows.items()
        for c in range(len(columns))
    }
    begins = [
        [
            start + (t - 1) * dt
            for t, mark in enumerate(marks[next(iter(rows)), c])
            if mark and not mark.age
        ]
        for c in range(len(columns))
    ]
    abreast = len(rows) == 2 and len(columns) == 1
    rate = math.ceil(RATE * dt - 1e-6) / dt
    count = len(pushed.force)
    pictures = cut.pictures(count, dt, start, itertools.chain.from_iterable(begins), rate)
    writer: Any
    with imageio.get_writer(path, fps=rate, macro_block_size=8, quality=8) as writer:
        for number in follow(range(len(pictures)), len(pictures)):
            moment, pace = pictures[number]
            t = int(moment / dt + 1e-6)
            share = max(0.0, moment / dt - t)
            time = start + min(moment, (count - 1) * dt)
            clock = f"{time:.2f} s" + (f"  x{pace:g}" if pace < 1 else "")
            lines = []
            for row, (name, states) in enumerate(rows.items()):
                tiles = []
                for c, column in enumerate(columns):
                    place(model, data, between(model, states[:, c], t, share))
                    renderer.update_scene(data, camera="track", scene_option=option)
                    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = shadows
                    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
                    mark = marks[name, c][t]
                    said = outcome_at(outcomes[name][c] if outcomes else (), time, mark, begins[c])
                    if mark and not (said and said[1] is False):
                        draw_arrow(renderer.scene, data, mark)
                    named = mark is not None and row == 0 and not abreast
                    tiles.append(
                        write_on(
                            renderer.render(),
                            title=f"{name}\n{column}",
                            clock=clock,
                            push=mark.label if mark and named else "",
                            outcome=said,
                        )
                    )
                lines.append(tiles)
            grid = _grid(lines)
            if abreast and (mark := marks[next(iter(rows)), 0][t]):
                grid = write_push(grid, mark.label)
            writer.append_data(grid)
    renderer.close()


def _grid(lines: list[list[NDArray[np.uint8]]]) -> NDArray[np.uint8]:
    """Pictures in lines; one long line becomes two, two lines of one picture become one."""
    if len(lines) == 2 and len(lines[0]) == 1:
        lines = [[lines[0][0], lines[1][0]]]
    elif len(lines) == 1 and len(lines[0]) > 2:
        tiles = lines[0] + [np.full_like(lines[0][0], 255)] * (len(lines[0]) % 2)
        half = len(tiles) // 2
        lines = [tiles[:half], tiles[half:]]
    return np.concatenate([np.concatenate(tiles, 1) for tiles in lines], 0)


def frame(env: HumanoidEnv) -> float:
    """Time between two states of the film: whole control steps, at most 0.04 s if they allow it."""
    return max(1, math.floor(1 / (RATE * env.control_dt) + 1e-6)) * env.control_dt


def between(
    model: mujoco.MjModel, states: NDArray[np.float64], t: int, share: float
) -> NDArray[np.float64]:
    """The state that lies a share of the way from ``states[t]`` ``(T, nq)`` to the next ``(nq,)``.

    A robot that is put somewhere else, 0.2 m or more away, jumps there.
    """
    here, there = states[t].copy(), states[min(t + 1, len(states) - 1)]
    if share == 0 or np.linalg.norm(there[:3] - here[:3]) > 0.2:
        return here
    step = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, step, 1.0, here, there)
    mujoco.mj_integratePos(model, here, step, share)
    return here


def _headings(states: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the robot faces in states ``(T, nq)``, which begin with its base ``(T,)`` [rad].

    While its trunk leans by more than 60 degrees, where it faced last: lying it faces nowhere.
    """
    w, x, y, z = states[:, 3:7].T
    facing = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    upright = 1 - 2 * (x * x + y * y) > 0.5
    last = np.maximum.accumulate(np.where(upright, np.arange(len(states)), 0))
    return np.asarray(facing[last])


def draw_arrow(scene: mujoco.MjvScene, data: mujoco.MjData, mark: Mark) -> None:
    """Adds an arrow that ends before the torso, 1 cm per newton up to 40 cm; it fades."""
    if scene.ngeom >= scene.maxgeom:
        return
    size = float(np.linalg.norm(mark.force))
    way = mark.force / size
    tip = data.body(1).subtree_com + np.array([0.0, 0.0, 0.08]) - 0.08 * way
    start = tip - way * min(0.01 * size, 0.4)
    alpha = 1.0 - 0.75 * min(mark.age / MARKED, 1.0)
    arrow, kind = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_ARROW
    color = np.array([0.835, 0.369, 0.0, alpha], dtype=np.float32)
    mujoco.mjv_initGeom(arrow, kind, np.zeros(3), np.zeros(3), np.zeros(9), color)
    mujoco.mjv_connector(arrow, kind, 0.014, start, tip)
    scene.ngeom += 1
