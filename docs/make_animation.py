"""Draws docs/pictures/pushed.gif: the policy ``best`` and ``pose_hold`` under the same pushes.

``MUJOCO_GL=egl .venv/bin/python docs/make_animation.py`` in the folder of the clone.
"""

import math
import subprocess
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from torchrl.envs import ExplorationType, set_exploration_type, step_mdp

import zfall

PICTURE = Path(__file__).parent / "pictures" / "pushed.gif"
PUSHES = {
    0.8: (20.0, 30.0),
    2.8: (25.0, 150.0),
    4.8: (30.0, 290.0),
}  # [s]: force [N], heading [deg]
DURATION, END = 0.1, 7.2  # of a push, of the film [s]
WIDTH, HEIGHT, BAR = 320, 260, 26  # of a robot's picture, and of the line of text above it [pixels]
EVERY = 2  # control steps from frame to frame


def text(line: str) -> NDArray[np.uint8]:
    """A line of text in the middle of a white bar."""
    figure = Figure(figsize=(WIDTH / 100, BAR / 100), dpi=100)
    figure.text(0.5, 0.5, line, ha="center", va="center", fontsize=10)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def force_at(time: float) -> tuple[NDArray[np.float64], str]:
    """What pushes at a time [N; world], and how to call it."""
    for begin, (newton, heading) in PUSHES.items():
        angle = math.radians(heading)
        label = f"{newton:.0f} N for {DURATION:g} s"
        if begin <= time < begin + DURATION - 1e-6:
            return newton * np.array([math.cos(angle), math.sin(angle), 0.0]), label
        if begin <= time < begin + 0.8:  # it can still be read
            return np.zeros(3), label
    return np.zeros(3), ""


def arrow(scene: mujoco.MjvScene, tip: NDArray[np.float64], force: NDArray[np.float64]) -> None:
    """Adds an arrow that ends at the torso, 1 cm per newton."""
    geom, red = scene.geoms[scene.ngeom], np.array([0.85, 0.2, 0.1, 1.0], dtype=np.float32)
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), red)
    mujoco.mjv_connector(geom, kind, 0.012, tip - 0.01 * force, tip)
    scene.ngeom += 1


policy = zfall.load_policy("best")
env = policy.env(num_envs=2)  # world 0 is the policy's, world 1 holds the standing pose
base = env.base_env
model = base.simulation.model
renderer, data = mujoco.Renderer(model, HEIGHT, WIDTH), mujoco.MjData(model)
option = mujoco.MjvOption()
option.sitegroup[:] = 0
frames = []
torso, substeps, dt = base.push_targets["torso"], base.substeps, base.control_dt
with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
    td = env.reset()
    shown, label = np.zeros(3), ""
    for step in range(round(END / dt)):
        times = step * dt + base.physics_dt * np.arange(substeps)
        forces = np.stack([force_at(time)[0] for time in times])
        wrench = torch.zeros(2, substeps, base.num_bodies, 6)
        wrench[:, :, torso, :3] = torch.from_numpy(forces).float()
        td["push", "wrench"] = wrench
        td = policy.actor(td)
        td["action"][1] = 0.0
        td = step_mdp(env.step(td))
        if forces.any():
            shown = forces[np.abs(forces).sum(1).argmax()]
        if step % EVERY:
            continue
        label = force_at(step * dt)[1]
        tiles = []
        for world, name in enumerate(("policy best", "servos hold the pose")):
            data.qpos[:] = base.simulation.qpos[world]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera="track", scene_option=option)
            renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
            if shown.any():
                arrow(renderer.scene, data.body("Top_Brace").xipos, shown)
            title = f"{name}: {label}" if label else name
            tiles.append(np.concatenate([text(title), renderer.render()]))
        frames.append(np.concatenate(tiles, 1))
        shown = np.zeros(3)
film = np.stack(frames)
subprocess.run(
    [
        *(imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error"),
        *("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{film.shape[2]}x{film.shape[1]}"),
        *("-r", f"{1 / (EVERY * dt):g}", "-i", "-"),
        *("-vf", "split[a][b];[a]palettegen=max_colors=64[p];[b][p]paletteuse=dither=none"),
        str(PICTURE),
    ],
    input=film.tobytes(),
    check=True,
)
print(f"wrote {PICTURE}: {len(film)} frames, {PICTURE.stat().st_size / 1e6:.2f} MB")
