"""Looks for postures that catch a fall: ``python -m recipes.catches``.

For each of five headings, from straight ahead to straight back, the robot is pushed; 0.12 s later
all joints go to a posture at the speed of its servos. Of 512 postures the best are kept and varied,
five times over (cross-entropy method). Good is what comes to rest with torso and head never on
the floor, at several sizes and headings of the push within 20 degrees, better upright and on
a knee or shin. Prints candidates for ``Robot.catches``; takes ten minutes.
"""

import math

import torch
from rich.console import Console
from tensordict import TensorDict
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms.kneel import resting_kneel, touching

HEADINGS = (0, 45, 90, 135, 180)  # [degrees]; those to the right are mirror images
# Size of a push and how far its heading is off [degrees].
PUSHES = ((0.6, 0.0), (0.8, 20.0), (1.0, -20.0), (1.0, 10.0), (1.25, -10.0), (1.5, 0.0))
DURATION, REACTION, END, SPEED = 0.1, 0.12, 1.8, 6.0  # [s, s, s, rad/s]
WORLDS, ELITE, ROUNDS, SHRINK = 512, 32, 5, 0.6
# What each side's joints are drawn from at first [rad], of the left one; the right one mirrors it.
RANGES = {
    "hip_yaw": (-0.4, 0.4),
    "hip_roll": (-0.3, 0.5),
    "hip_pitch": (-1.57, 0.87),
    "knee_pitch": (-1.39, 0.0),
    "ankle_pitch": (-0.7, 0.69),
    "shoulder_pitch": (-1.0, 2.0),
    "shoulder_roll": (-0.4, 2.2),
    "elbow_roll": (-0.8, 1.5),
}


def draw(env: HumanoidEnv, generator: torch.Generator) -> Tensor:
    """Postures ``(WORLDS, J)`` [rad], the first half of them left as right."""
    angles = env.stand_position.repeat(WORLDS, 1)
    for name, (low, high) in RANGES.items():
        left, right = low + (high - low) * torch.rand(2, WORLDS, generator=generator)
        right[: WORLDS // 2] = left[: WORLDS // 2]
        one, other = (env.robot.joints.index(f"{side}_{name}") for side in ("left", "right"))
        angles[:, one] = left
        angles[:, other] = env.robot.mirror_sign[other] * right
    return angles


def caught(env: HumanoidEnv, postures: Tensor, size: float, heading: float) -> tuple[Tensor, ...]:
    """Of each posture ``(WORLDS,)``: does it catch a push, kneel upright then, and for how long?

    The last is the share of the time that torso and head were off the floor.
    """
    env.reset()
    force = size * env.robot.impulse_unit / DURATION
    body = env.push_targets["torso"]
    along = torch.tensor([math.cos(heading), math.sin(heading)])
    way = env.stand_position.repeat(WORLDS, 1)
    reach = SPEED * env.control_dt
    untouched = torch.ones(WORLDS, dtype=torch.bool)
    lasted, steps = torch.zeros(WORLDS), round(END / env.control_dt)
    for step in range(steps):
        time = step * env.control_dt
        if time > REACTION - 1e-6:
            way = way + (postures - way).clamp(-reach, reach)
        td = TensorDict({"target": way}, batch_size=[WORLDS])
        if time < DURATION:
            wrench = env.zero_wrench()
            on = time + torch.arange(wrench.shape[1]) * env.physics_dt < DURATION - 1e-6
            wrench[:, on, body, :2] = force * along
            td["push", "wrench"] = wrench
        td = env.step(td)["next"]
        untouched &= ~touching(td, env.robot, "torso", "head").squeeze(-1)
        lasted += untouched / steps
        env.simulation.step_only(untouched)
    env.simulation.step_only(None)
    still = td["base_linear_velocity"].norm(dim=-1) < 0.1
    still &= td["base_angular_velocity"].norm(dim=-1) < 0.1
    kneels = resting_kneel(td, td, robot=env.robot).squeeze(-1)
    return untouched & still, untouched & kneels, lasted


def score(env: HumanoidEnv, postures: Tensor, heading: int) -> Tensor:
    """How good postures are for a heading ``(WORLDS,)``, at most 4 for each push."""
    total = torch.zeros(WORLDS)
    for size, off in PUSHES:
        safe, kneels, lasted = caught(env, postures, size, math.radians(heading + off))
        total += safe.float() + 2.0 * kneels.float() + lasted
    return total


def search(env: HumanoidEnv, heading: int, console: Console) -> Tensor:
    """The best posture for a heading ``(J,)`` [rad]."""
    generator = torch.Generator().manual_seed(heading)
    low, high = env.joint_range.unbind(-1)
    postures = draw(env, generator).clamp(low, high)
    for turn in range(ROUNDS):
        best = score(env, postures, heading).topk(ELITE)
        kept = postures[best.indices]
        console.print(f"{heading}, round {turn}: {best.values[0]:.1f} of {4 * len(PUSHES)}")
        parents = kept[torch.randint(ELITE, (WORLDS,), generator=generator)]
        noise = torch.randn(postures.shape, generator=generator)
        postures = (parents + SHRINK * kept.std(0) * noise).clamp(low, high)
        postures[:ELITE] = kept
    return kept[0]


def main() -> None:
    """Searches, and prints what was found; what is best for one heading is tried for all."""
    console = Console()
    env = HumanoidEnv(num_envs=WORLDS, control_dt=0.04, physics_dt=0.004)
    robot = env.robot
    found = [search(env, heading, console) for heading in HEADINGS]
    found += [torch.tensor(robot.mirrored(pose.tolist())) for pose in found]
    every = torch.stack(found).repeat(-(-WORLDS // len(found)), 1)[:WORLDS]
    for heading in HEADINGS:
        best = score(env, every, heading).max(0)
        pose = every[best.indices].tolist()
        named = {j: round(a, 2) for j, a in zip(robot.joints, pose, strict=True) if abs(a) > 0.005}
        console.print(f"{heading}: {named},  # {best.values:.1f}", soft_wrap=True)


if __name__ == "__main__":
    main()
