"""How robots lie or kneel before they get up: the postures, and how states in them are made."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from omegaconf import DictConfig
from rich.console import Console
from tensordict import TensorDict
from torch import Tensor

from zfall.arrays import arrays_of
from zfall.envs.humanoid import STATE_KEYS, HumanoidEnv
from zfall.errors import check_number
from zfall.evaluation.definitions import load_battery
from zfall.falling.banks import load_bank
from zfall.falling.files import own_file
from zfall.falling.modes import STABLE
from zfall.falling.pushed import PUSH_TIME, SPREAD, pushed_worlds, world_of
from zfall.robots import Robot
from zfall.rotations import from_angles, turned
from zfall.terminal import QUIET

POSTURES = ("back", "belly", "left", "right", "kneel")
# Where gravity points in axes of the base, by posture; upright is a kneel, or a squat.
_DOWN = torch.tensor(
    [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]
)
SETTLE = 2.0  # time in which a robot comes to rest on the floor [s]
_DROP = 0.15  # height of the base when it is let go [m]
_NOISE = 0.3  # of the joints then, around the standing pose [rad]
_REST = 0.2  # of the base and of the joints, at most, to count as lying still [m/s, rad/s]
_KEYS = (*STATE_KEYS, "target")


def posture_of(gravity: Tensor) -> Tensor:
    """Positions in ``POSTURES`` ``(N,)`` for gravity in axes of the base ``(N, 3)``."""
    return (gravity @ _DOWN.T).argmax(-1)


def lying_path(robot: Robot) -> Path:
    """The file of a robot's states that ships."""
    return own_file(robot, "lying.npz")


def load_lying(robot: Robot, path: Path | None = None) -> dict[str, Tensor]:
    """States of a file that ``recipes.falling.lying`` wrote; without a path, those that ship.

    Returns:
        ``(K, D)`` float32 under ``STATE_KEYS`` and ``target``, the target of the servos [rad], and
        ``(K,)`` under ``posture``, positions in ``POSTURES``.

    Raises:
        ValueError: if there is no such file, or it is of another robot or kind.
    """
    path = path or lying_path(robot)
    rule = "bank must be a file that recipes.falling.lying wrote"
    with arrays_of(path, rule) as file:
        posture = torch.from_numpy(file["posture"]).long()
    states = load_bank(path, robot, needs=("target",))
    if posture.shape != (len(states["target"]),) or not (0 <= posture.min() <= posture.max() < 5):
        raise ValueError(f"{rule}, {path} does not say a posture of each state: record it again.")
    return {key: states[key] for key in _KEYS} | {"posture": posture}


def settled(
    env: HumanoidEnv, posture: str, generator: np.random.Generator, *, held: bool
) -> dict[str, Tensor]:
    """States of robots that were let go just above the floor and came to rest in a posture.

    They are dropped in the posture with noise on their joints and any heading. Many roll over,
    from a side above all; what is returned are those that lie still in it, perhaps none.

    Args:
        env: in whose worlds they settle; one without power is limp.
        posture: one of ``POSTURES`` but the kneel.
        generator: of noise and headings.
        held: whether the servos keep the joints where they were at the drop; else their target is
            where the joints came to rest.

    Returns:
        ``(K, D)`` under ``STATE_KEYS`` and ``target``.
    """
    count, low, high = env.num_envs, *env.joint_range.numpy().T
    noise = generator.normal(0.0, _NOISE, (count, len(low)))
    angles = torch.tensor(np.clip(env.stand_position.numpy() + noise, low, high)).float()
    x, y, _ = _DOWN[POSTURES.index(posture)].tolist()
    lean = torch.tensor([-y, x, 0.0]).expand(count, 3) * math.pi / 2.0  # roll, pitch, yaw
    heading = torch.tensor(generator.uniform(-math.pi, math.pi, count)).float()
    start = {
        "joint_position": angles,
        "base_orientation": turned(from_angles(lean), heading),
        "base_position": torch.tensor([0.0, 0.0, _DROP]).repeat(count, 1),
    }
    env.reset(TensorDict({"start": start}, [count]))
    for _ in range(round(SETTLE / env.control_dt)):
        td = env.step(TensorDict({"target": angles}, [count]))["next"]
    speeds = (td["base_linear_velocity"], td["base_angular_velocity"], td["joint_velocity"])
    rests = (torch.stack([speed.abs().amax(-1) for speed in speeds]) < _REST).all(0)
    rests &= posture_of(td["projected_gravity"]) == POSTURES.index(posture)
    target = angles if held else td["joint_position"]
    return _rows({key: td[key] for key in STATE_KEYS} | {"target": target}, rests)


def lying_bank(env: HumanoidEnv, limp: HumanoidEnv, count: int, *, seed: int) -> dict[str, Tensor]:
    """``count`` states of each posture but the kneel, half with servos on, half settled limp.

    Args:
        env: in whose worlds robots settle with their servos on.
        limp: likewise, without power.
        count: of each posture.
        seed: of noise and headings.

    Returns:
        As ``load_lying``.

    Raises:
        ValueError: if a posture is not come by.
    """
    check_number(count, "count", lambda x: x >= 2, "be at least 2")
    generator, parts = np.random.default_rng(seed), list[dict[str, Tensor]]()
    for number, posture in enumerate(POSTURES[:-1]):
        for held, worlds, wanted in ((True, env, count - count // 2), (False, limp, count // 2)):
            found, tries = 0, 0
            while found < wanted:
                tries += 1
                some = settled(worlds, posture, generator, held=held)
                some = {key: value[: wanted - found] for key, value in some.items()}
                rows = len(some["target"])
                parts.append(some | {"posture": torch.full((rows,), number)})
                found += rows
                if tries > 50 and not found:
                    raise ValueError(f"count must be 0 of {posture}: no robot rests so.")
    return joined(parts)


def joined(parts: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Banks one after the other."""
    return {key: torch.cat([part[key] for part in parts]) for key in parts[0]}


def kneeling_bank(
    env_cfg: DictConfig,
    actor: torch.nn.Module | None,
    count: int,
    *,
    seed: int,
    world: str | None = None,
    console: Console = QUIET,
) -> dict[str, Tensor]:
    """States in which a policy that kneels has come to rest after pushes, mode STABLE.

    It is pushed at the torso from 24 directions by I = 1 to 1.5, in the world of ``env_cfg``.

    Args:
        env_cfg: config of an env with modes.
        actor: the policy; ``None`` for a baseline that kneels by script.
        count: of states, at most.
        seed: of the pushes.
        world: battery whose hardware is met, ``twin``; ``None``: that of the env.
        console: for the progress bar.

    Returns:
        As ``load_lying``, all in posture kneel.

    Raises:
        ValueError: if the env has no modes.
    """
    if env_cfg.transforms.get("mode") is None:
        raise ValueError("run must be a policy that kneels, with modes.")
    impulses = [1.0, 1.25, 1.5]
    battery = load_battery(
        "envelope",  # which may have any impulses
        point=["torso"],
        impulses=impulses,
        starts=math.ceil(2 * count / (24 * len(impulses))),  # half of them kneel, or more
        push_time=PUSH_TIME,
        end_time=PUSH_TIME + SPREAD + 4.0,
        directions=24,
        world=world_of(world),
    )
    worlds = pushed_worlds(battery, env_cfg, seed=seed, control_arm=False)
    trials, seen, parts = len(worlds.trials), None, list[dict[str, Tensor]]()
    for td in worlds.play(actor, battery.end_time, console):
        stable = td["mode"][:trials, STABLE] > 0
        stable &= posture_of(td["projected_gravity"][:trials]) == POSTURES.index("kneel")
        new = stable if seen is None else stable & ~seen
        seen = stable if seen is None else stable | seen
        parts.append(_rows({key: td[key][:trials] for key in _KEYS}, new))
    states = joined(parts)
    chosen = torch.from_numpy(np.random.default_rng(seed).permutation(len(states["target"])))
    states = _rows(states, chosen[:count])
    return states | {"posture": torch.full((len(states["target"]),), POSTURES.index("kneel"))}


def _rows(states: Mapping[str, Tensor], rows: Tensor) -> dict[str, Tensor]:
    """Some of the states, with the base above the origin."""
    some = {key: value.flatten(1)[rows].clone() for key, value in states.items()}
    some["base_position"][:, :2] = 0.0
    return some
