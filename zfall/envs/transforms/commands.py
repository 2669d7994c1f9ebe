"""Commands: how the robot shall move."""

from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env, streams_of
from zfall.envs.transforms.pushes.draws import between, check_range
from zfall.envs.transforms.values import reset_rows
from zfall.rotations import wrap
from zfall.values import Bounds, Times

ENTRIES = ("vx", "vy", "yaw", "height", "roll", "pitch")


class Command(Transform):
    """Commands how the robot shall move, in six numbers; all are 0 unless a range is given.

    ========= =============================================================
    entry     content
    ========= =============================================================
    vx, vy    velocity of the base forward and to the left [m/s]
    yaw       heading of the base, 0 along the world's x axis [rad];
              with ``turning`` its rate to the left [rad/s]
    height    of the base, from that of the standing pose [m]
    roll      of the base, to the right [rad]
    pitch     of the base, forward [rad]
    ========= =============================================================

    The command observed before a step is the one for that step. With ``turning`` the entry yaw is
    the rate at which the heading shall turn [rad/s]; that heading follows from it, from 0 at the
    begin of an episode, in [-pi, pi).

    Keys: writes ``command`` ``(N, 6)``, with ``turning`` also ``commanded_heading`` ``(N, 1)``
    [rad].

    Args:
        env: the base env.
        ranges: by name of an entry, its smallest and largest value; uniform.
        interval: shortest and longest time after which a new command is drawn [s]; ``null`` keeps
            that of the begin of the episode.
        turning: whether yaw is a rate.

    Raises:
        ValueError: on another entry, a bad range, or an interval shorter than a control step.

    Source: the entries are those of the Zeroth-01 project's report; the draws are ours.
    """

    operator = ("command",)  # given from outside on a robot, too
    units: ClassVar[Mapping[str, str]] = {
        "command": "m/s, m/s, rad, m, rad, rad",
        "commanded_heading": "rad",
    }

    mirror_signs: ClassVar[Mapping[str, tuple[float, ...]]] = {"commanded_heading": (-1.0,)}

    command: Tensor
    heading: Tensor
    rest: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        ranges: Mapping[str, Bounds] | None = None,
        interval: Times | None = None,
        turning: bool = False,
    ):
        keys = ["command", "commanded_heading"] if turning else ["command"]
        super().__init__(in_keys=[], out_keys=keys)
        needs_env(self, env, "a memory of each world")
        for name, bounds in (ranges or {}).items():
            if name not in ENTRIES:
                raise ValueError(f"ranges must be of {', '.join(ENTRIES)}, got {name!r}.")
            check_range(f"ranges.{name}", bounds, negative=True)
        if interval is not None:
            check_range("interval", interval)
            if interval[0] < env.control_dt:
                raise ValueError(
                    f"interval must be at least control_dt ({env.control_dt}), "
                    f"got {list(interval)}."
                )
        self.ranges: dict[str, Any] = {
            name: list(bounds) for name, bounds in (ranges or {}).items()
        }
        self.interval, self.control_dt, self.turning = interval, env.control_dt, turning
        if turning:  # else runs from before it could would lack it when they are resumed
            self.register_buffer("heading", torch.zeros(env.num_envs))
        self.register_buffer("command", torch.zeros(env.num_envs, len(ENTRIES)))
        # Until the next draw [s]; float64, as times add up over episodes.
        self.register_buffer("rest", torch.full((env.num_envs,), torch.inf, dtype=torch.float64))

    def give(self, command: Tensor) -> None:
        """Gives each world its own command ``(N, 6)`` for its coming episodes, instead of draws."""
        columns = zip(ENTRIES, command.unbind(-1), strict=True)
        self.ranges = {name: torch.stack([column, column]) for name, column in columns}
        self.interval = None

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self.turning:
            self.heading = wrap(self.heading + self.command[:, 2] * self.control_dt)
        if self.ranges and self.interval is not None:
            self.rest = self.rest - self.control_dt
            self._draw(self.rest < 0.5 * self.control_dt)
        return self._write(next_tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        rows = reset_rows(tensordict, self)
        if self.turning:
            self.heading = self.heading.masked_fill(rows, 0.0)
        if self.ranges:
            self._draw(rows)
        return self._write(tensordict_reset)

    def _write(self, tensordict: TensorDictBase) -> TensorDictBase:
        if self.turning:
            tensordict["commanded_heading"] = self.heading[:, None].clone()
        return tensordict.set("command", self.command.clone())

    def _draw(self, rows: Tensor) -> None:
        """New commands for the worlds in ``rows`` ``(N,)`` bool."""
        u = streams_of(self).uniform((len(self.ranges) + 1,), rows).T
        for value, (name, bounds) in zip(u, self.ranges.items(), strict=False):
            entry = self.command[:, ENTRIES.index(name)]
            entry.copy_(torch.where(rows, between(bounds, value), entry))
        if self.interval is not None:
            self.rest = torch.where(rows, between(self.interval, u[-1].double()), self.rest)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        observation_spec["command"] = Unbounded(self.command.shape)
        if self.turning:
            observation_spec["commanded_heading"] = Unbounded((len(self.command), 1))
        return observation_spec
