"""Starts from which to kneel: in the midst of falls, and on the way down."""

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Transform

from zfall.envs.humanoid import STATE_KEYS, HumanoidEnv
from zfall.envs.model import lowest_point
from zfall.envs.transforms.values import per_world


class FallingStart(Transform):
    """Starts episodes in the midst of falls, states recorded from a policy that was pushed.

    Writes ``("start", NAME)`` ``(N, ...)`` for all ``STATE_KEYS`` in a share of the worlds; the
    others begin as what comes before it in the table says. ``python -m recipes.falls`` records.

    Args:
        env: the base env.
        bank: file with arrays ``(K, ...)`` for all ``STATE_KEYS``; ``None``: that of the robot.
        share: of the episodes that begin in a fall.

    Raises:
        ValueError: if the file is missing, or is of another robot, or the share is not in (0, 1].
    """

    def __init__(self, env: HumanoidEnv, *, bank: str | None = None, share: float = 1.0):
        super().__init__()
        if not 0 < share <= 1:
            raise ValueError(f"share must lie in (0, 1], got {share}.")
        own = Path(env.robot.mjcf).with_name(f"{env.robot.name}_falls.npz")
        path = own if bank is None else Path(bank)
        if not path.is_file():
            raise ValueError(f"bank must be a file that recipes.falls wrote, there is no {path}.")
        with np.load(path) as file:
            states = {key: torch.from_numpy(file[key]).float() for key in STATE_KEYS}
        if states["joint_position"].shape[1] != len(env.stand_position):
            raise ValueError(f"bank must be of {env.robot.name}, {path} has other joints.")
        self.share, self.num_envs, self.rng = share, env.num_envs, env.rng
        self.sizes = {key: value.shape[-1] for key, value in states.items()}
        self.table = torch.cat(list(states.values()), -1)
        base = torch.tensor(env.simulation.model.key("stand").qpos).float()
        self.stand = {  # of the other worlds, whose soles are put on the floor
            "base_position": torch.full((3,), torch.nan),
            "base_orientation": base[3:7],
            "joint_position": env.stand_position,
        }

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        # All rows are drawn, so that the random stream does not depend on who fell.
        row = torch.randint(len(self.table), (self.num_envs,), generator=self.rng)
        falls = torch.rand(self.num_envs, 1, generator=self.rng) < self.share
        values = self.table.index_select(0, row).split(list(self.sizes.values()), -1)
        for name, value in zip(self.sizes, values, strict=True):
            there = tensordict.get(("start", name), None)
            if there is None:
                there = self.stand.get(name, torch.zeros_like(value)).expand_as(value)
            tensordict["start", name] = torch.where(falls, value, there)
        return tensordict


class KneelStart(Transform):
    """Starts episodes at rest on the way from standing to the robot's kneel, or its mirror image.

    Joint angles and the base's attitude lie in between, the lowest point is put on the floor. A
    curriculum that moves ``depth`` from the kneel to standing teaches the way down from its end.

    Writes ``("start", NAME)`` ``(N, ...)`` for ``joint_position`` [rad], ``joint_velocity``
    [rad/s], ``base_orientation`` and ``base_position`` [m].

    Args:
        env: the base env.
        depth: smallest and largest share of the way, uniform; 0 is standing, 1 the kneel.
        joint_position: standard deviation of each angle [rad]; they stay in the joint ranges.
        joint_velocity: standard deviation of each speed [rad/s].

    Raises:
        ValueError: if the robot has no kneel, or ``depth`` is no range in [0, 1].
    """

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        depth: Sequence[float],
        joint_position: float = 0.0,
        joint_velocity: float = 0.0,
    ):
        super().__init__()
        if not env.robot.kneel:
            raise ValueError(f"KneelStart needs a robot with a kneel, {env.robot.name} has none.")
        if not 0.0 <= depth[0] <= depth[1] <= 1.0:
            raise ValueError(f"depth must be [least, most] in [0, 1], got {list(depth)}.")
        self.depth = list(depth)
        self.joint_position, self.joint_velocity = joint_position, joint_velocity
        self.rng, self.range, self.num_envs = env.rng, env.joint_range, env.num_envs
        self.way = torch.from_numpy(_way_down(env)).float()
        self.sizes = {"base_position": 3, "base_orientation": 4, "joint_position": len(self.range)}
        self.index = list(env.robot.mirror_index)
        self.sign = torch.tensor(env.robot.mirror_sign).float()

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        # All rows are drawn, so that the random stream does not depend on who fell.
        u, side = torch.rand(2, self.num_envs, 1, generator=self.rng)
        noise = torch.randn(2, self.num_envs, len(self.sign), generator=self.rng)
        least, most = (per_world(bound, 2) for bound in self.depth)
        place = (least + (most - least) * u) * (len(self.way) - 1)
        low = place.long().clamp_max(len(self.way) - 2)
        state = torch.lerp(self.way[low[:, 0]], self.way[low[:, 0] + 1], place - low)
        values = dict(zip(self.sizes, state.split(list(self.sizes.values()), -1), strict=True))
        left = side < 0.5
        turn, angle = values["base_orientation"], values["joint_position"]
        values["base_orientation"] = torch.where(left, turn * turn.new_tensor([1, -1, 1, -1]), turn)
        angle = torch.where(left, angle[:, self.index] * self.sign, angle)
        angle = angle + per_world(self.joint_position, 2) * noise[0]
        values["joint_position"] = torch.clamp(angle, *self.range.unbind(-1))
        values["joint_velocity"] = per_world(self.joint_velocity, 2) * noise[1]
        for name, value in values.items():
            tensordict["start", name] = value
        return tensordict


def _way_down(env: HumanoidEnv, places: int = 33) -> NDArray[np.float64]:
    """States from standing to the kneel ``(places, 3 + 4 + J)``: position, attitude, joints."""
    model = env.simulation.model
    data = mujoco.MjData(model)
    columns = [int(model.joint(joint).qposadr[0]) for joint in env.robot.joints]
    stand, kneel = (model.key(name).qpos for name in ("stand", "kneel"))
    ends = Rotation.from_quat(np.stack([stand[3:7], kneel[3:7]]), scalar_first=True)
    shares = np.linspace(0.0, 1.0, places)
    turns = Slerp([0.0, 1.0], ends)(shares).as_quat(scalar_first=True)
    rows = []
    for share, turn in zip(shares, turns, strict=True):
        data.qpos[:] = (1 - share) * stand + share * kneel
        data.qpos[:3], data.qpos[3:7] = 0.0, turn
        mujoco.mj_kinematics(model, data)
        height = 0.001 - lowest_point(model, data)
        rows.append([0.0, 0.0, height, *turn, *data.qpos[columns]])
    return np.array(rows)
