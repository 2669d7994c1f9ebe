"""Draws docs/pictures/pushed.gif: the policy ``twin`` and ``pose_hold`` under the same pushes.

``MUJOCO_GL=egl .venv/bin/python docs/make_animation.py`` in the folder of the clone. Their world is
the policy's task with servos by their datasheets, without the noise, the delays and the drawn
physics of the training.
"""

import math
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

import imageio_ffmpeg
import numpy as np
import torch
from torchrl.envs import ExplorationType, set_exploration_type, step_mdp

import zfall
from zfall.envs.terms.falls import body_contact
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.evaluation.captions import PushLog
from zfall.evaluation.endings import said
from zfall.evaluation.video import film

PICTURE = Path(__file__).parent / "pictures" / "pushed.gif"
PUSHES = {0.8: (20.0, 0.0), 2.8: (20.0, 90.0), 4.8: (25.0, 180.0)}  # [s]: force [N], heading [deg]
DURATION, END = 0.1, 6.8  # of a push, of the film [s]
NAMES = ("policy twin", "servos hold the pose")
GIF = "fps=12.5,split[a][b];[a]palettegen=max_colors=96[p];[b][p]paletteuse=dither=none"

policy = zfall.load_policy("twin")
env = policy.env(num_envs=2)  # world 0 is the policy's, world 1 holds the standing pose
base, dt = env.base_env, env.base_env.control_dt
plan = [
    [force * math.cos(math.radians(angle)), force * math.sin(math.radians(angle)), 0.0]
    for force, angle in PUSHES.values()
]
env.append_transform(
    ScriptedPush(base, point=["torso"] * len(plan), duration=DURATION, time=list(PUSHES), plan=plan)
)
states, log = [], PushLog(2)
fall_time = torch.full((2,), torch.nan)
with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
    td = env.reset()
    for step in range(round(END / dt)):
        td = policy.actor(td)
        td["action"][1] = 0.0
        td = env.step(td)
        down = body_contact(td, td["next"])[:, 0] & fall_time.isnan()
        fall_time[down] = (step + 1) * dt
        states.append(base.simulation.qpos.numpy().copy())
        log.add(td["next"])
        td = step_mdp(td)
shown = np.stack(states)
pushed = log.frames(range(1, len(states) + 1))
outcomes = [said(float(time), END) for time in fall_time]
print({name: outcome[-1][:2] for name, outcome in zip(NAMES, outcomes, strict=True)})
with TemporaryDirectory() as folder:
    path = f"{folder}/film.mp4"
    film(
        base.camera.model,
        {name: shown[:, [index]] for index, name in enumerate(NAMES)},
        ["servos by the makers' sheets, nominal world"],
        pushed.of([0]),
        Path(path),
        dt=dt,
        tile=(400, 320),
        outcomes={name: [outcomes[index]] for index, name in enumerate(NAMES)},
    )
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", "-i", path]
    subprocess.run([*command, "-filter_complex", GIF, str(PICTURE)], check=True)
print(f"wrote {PICTURE}: {PICTURE.stat().st_size / 1e6:.2f} MB")
