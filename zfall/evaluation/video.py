"""Films of trials: a row for each policy, a column for each push."""

from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import mujoco
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.rendering import make_renderer


def film(
    model: mujoco.MjModel,
    rows: dict[str, NDArray[np.float64]],
    columns: list[str],
    forces: NDArray[np.floating],
    path: Path,
    *,
    dt: float,
    tile: tuple[int, int] = (320, 240),
) -> None:
    """Writes an mp4 of a grid: one row per policy, one column per push.

    An arrow shows the force while it acts.

    Args:
        model: of the worlds.
        rows: by name of the policy, positions ``(T, columns, nq)`` in MuJoCo's order.
        columns: name of each column's push.
        forces: mean force over each step ``(T, columns, 3)`` [N; world].
        path: file to write.
        dt: time between two frames [s].
        tile: width and height of one picture [pixels].

    Raises:
        RuntimeError: if no OpenGL is to be had.
    """
    model.vis.quality.offsamples = 2  # software OpenGL pays for every sample
    renderer = make_renderer(model, *tile)
    option = mujoco.MjvOption()
    option.sitegroup[:] = 0
    data = mujoco.MjData(model)
    header, gutter = _captions(list(rows), columns, tile)
    steps = len(forces)
    writer: Any
    with imageio.get_writer(path, fps=1 / dt, macro_block_size=8, quality=7) as writer:
        for t in range(steps):
            lines = [header]
            for index, states in enumerate(rows.values()):
                tiles = [gutter[index]]
                for c in range(len(columns)):
                    data.qpos[:] = states[t, c]
                    mujoco.mj_forward(model, data)
                    renderer.update_scene(data, camera="track", scene_option=option)
                    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
                    renderer.scene.flags[mujoco.mjtRndFlag.mjRND_HAZE] = 0
                    _draw_arrow(renderer.scene, data, forces[t, c])
                    tiles.append(renderer.render())
                lines.append(np.concatenate(tiles, 1))
            writer.append_data(np.concatenate(lines, 0))
    renderer.close()


def frame(env: HumanoidEnv) -> float:
    """Time between two frames of the film: whole control steps, about 0.08 s."""
    return max(1, round(0.08 / env.control_dt)) * env.control_dt


def _draw_arrow(scene: mujoco.MjvScene, data: mujoco.MjData, force: NDArray[np.float64]) -> None:
    """Adds an arrow that ends at the torso, 1 cm per newton."""
    if np.linalg.norm(force) < 0.1 or scene.ngeom >= scene.maxgeom:
        return
    tip = data.body("Top_Brace").xipos
    arrow = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        arrow,
        mujoco.mjtGeom.mjGEOM_ARROW,
        np.zeros(3),
        np.zeros(3),
        np.zeros(9),
        np.array([0.85, 0.2, 0.1, 1.0], dtype=np.float32),
    )
    start = tip - 0.01 * force
    mujoco.mjv_connector(arrow, mujoco.mjtGeom.mjGEOM_ARROW, 0.012, start, tip)
    scene.ngeom += 1


def _captions(
    names: list[str], columns: list[str], tile: tuple[int, int]
) -> tuple[NDArray[np.uint8], list[NDArray[np.uint8]]]:
    """Pictures with the names of columns (above) and rows (at the left)."""
    width, height = tile
    side, top = 32, 32
    cells = [_text(name, width, top) for name in columns]
    header = np.concatenate([np.full((top, side, 3), 255, np.uint8), *cells], 1)
    gutter = [np.ascontiguousarray(np.rot90(_text(name, height, side))) for name in names]
    return header, gutter


def _text(text: str, width: int, height: int) -> NDArray[np.uint8]:
    """Black text in the middle of a white picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure = Figure(figsize=(width / 100, height / 100), dpi=100)
    figure.text(0.5, 0.5, text, ha="center", va="center", fontsize=11)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
