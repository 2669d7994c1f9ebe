"""A policy or baseline that acts in its worlds one control step at a time."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from hydra.utils import instantiate
from numpy.typing import NDArray
from omegaconf import OmegaConf
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import ExplorationType, set_exploration_type, step_mdp

from zfall.envs.make import left_out, make_env
from zfall.envs.transforms.actions import ActuatorDelay
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.envs.transforms.starts import ScriptedStart
from zfall.evaluation.battery import hold_pose, starts_and_pushes
from zfall.evaluation.candidate import Candidate
from zfall.modules.memory import carry_memory
from zfall.simulation.turns import physics_first

START_NOISE = 0.035  # [rad] as in the batteries, two degrees: else all worlds would do the same
LONGEST_DELAY = 0.1  # [s]


class Player:
    """A candidate in N worlds of its own env, with pushes, starts and latency of the viewer.

    Args:
        candidate: the policy or baseline.
        num_envs: number of worlds N.
        seed: of the starts.

    Attributes:
        env: the task; its own starts and pushes, and its ``training_only``, are left out.
        actor: the policy; ``None`` of a baseline. Another one of the same shape may take over.
        seen: what followed the last step, or the last reset of all worlds.
        fell: worlds ``(N,)`` bool that the task has ended since their last reset.
        time: of the simulation since the player began [s].
    """

    def __init__(self, candidate: Candidate, num_envs: int, seed: int = 0):
        self.candidate, self.num_envs = candidate, num_envs
        cfg = candidate.env_cfg
        base = instantiate(
            cfg.base_env, num_envs=num_envs, powered=candidate.servos, threads=1, _convert_="all"
        )
        self.points = list(base.parameters.push_points)
        stand = base.stand_position.repeat(num_envs, 1)
        self._start = ScriptedStart(base, states={"joint_position": stand})
        self._push = ScriptedPush(
            base,
            point=self.points,  # each has a push of its own, which may overlap
            duration=0.1,
            time=math.inf,
            plan=torch.zeros(num_envs, len(self.points), 3),
        )
        self._delay = ActuatorDelay(
            base, delay=(0.0, 0.0), max_delay=LONGEST_DELAY, per="step", joints="shared"
        )
        gone = left_out(OmegaConf.select(cfg, "training_only", default={}))
        ours = {"view_start": self._start, "view_push": self._push, "view_latency": self._delay}
        self.env = make_env(
            base,
            dict(cfg.transforms.items()) | ours,
            training_only={*gone, *starts_and_pushes(cfg)},
            training=False,
        )
        self.actor = candidate.actor
        if self.actor is not None:
            carry_memory(self.env, self.actor)
        self._hold: Any = hold_pose(self.env)
        named = (t.mode_names for t in self.env.transform if hasattr(t, "mode_names"))
        self._modes: Sequence[str] = next(named, ())
        self._random = np.random.default_rng(seed)
        self._nominal = {k: v.clone() for k, v in base.parameters.values.items()}
        self.env.set_seed(seed)
        self._moved: dict[str, float] = {}  # parameters that somebody has chosen
        self.time, self.fell = 0.0, torch.zeros(num_envs, dtype=torch.bool)
        self.seen: TensorDictBase = TensorDict(batch_size=[num_envs])
        self._now: TensorDictBase = self.seen
        self._states = np.zeros((num_envs, base.substeps, base.simulation.model.nq))
        self.reset()

    @property
    def control_dt(self) -> float:
        """Time between two actions [s]."""
        return float(self.env.base_env.control_dt)

    @property
    def states(self) -> NDArray[np.float64]:
        """Positions after each of the S physics steps of the last step ``(N, S, nq)``."""
        return self._states

    def mode(self, world: int) -> str | None:
        """The mode of a world, if its task has modes; without a name for it its number."""
        if "mode" not in self.seen.keys():
            return None
        number = int(self.seen["mode"][world].argmax())
        return self._modes[number] if number < len(self._modes) else f"mode {number}"

    @torch.no_grad()
    def step(self) -> None:
        """Takes one control step in all worlds, without exploration."""
        act = self._hold if self.actor is None else self.actor
        with physics_first(), set_exploration_type(ExplorationType.DETERMINISTIC):
            td = self.env.step(act(self._now))
            self.seen, self._now = td["next"], step_mdp(td)
        self.fell |= self.seen["terminated"][:, 0]
        self.time += self.control_dt
        self._states = self.env.base_env.simulation.substates[0].numpy().copy()

    @torch.no_grad()
    def reset(self, rows: Tensor | None = None) -> None:
        """Puts worlds back to the standing pose, a little disturbed, and ends their pushes.

        Args:
            rows: which worlds ``(N,)`` bool; all if ``None``.
        """
        base = self.env.base_env
        everyone = torch.ones(self.num_envs, dtype=torch.bool)
        rows = everyone if rows is None else rows
        noise = START_NOISE * self._random.standard_normal((self.num_envs, len(base.robot.joints)))
        low, high = base.joint_range.unbind(-1)
        self._start.states["joint_position"] = torch.clamp(
            base.stand_position + torch.from_numpy(noise).float(), low, high
        )
        if rows.all():
            self.seen = self._now = self.env.reset()
        else:
            self._now = self.env.reset(self._now.set("_reset", rows[:, None]))
        if self._moved:
            self.set_physics(self._moved)  # over what the reset drew
        self.fell &= ~rows
        here = base.simulation.qpos.numpy()[:, None].repeat(base.substeps, 1)
        self._states = np.where(rows.numpy()[:, None, None], here, self._states)

    def push(self, rows: Tensor, point: str, impulse: Tensor, duration: float) -> None:
        """Pushes worlds from the coming step on, by the law of the batteries' pushes.

        Args:
            rows: which worlds ``(N,)`` bool.
            point: one of ``points``.
            impulse: ``(3,)`` [N s; world].
            duration: [s].
        """
        self._push.begin(rows, self.points.index(point), impulse / duration, duration)

    def set_latency(self, seconds: float) -> None:
        """How late commands reach the servos, on top of what the env has [s]."""
        self._delay.delay = (seconds, seconds)

    def set_physics(self, values: Mapping[str, float]) -> None:
        """Gives all worlds the same physical parameters, which resets do not change.

        Those that were named before and are not any more become nominal; others stay.

        Args:
            values: by name, of every element of a parameter; but ``slope`` is how far the floor
                falls to the front [rad], ``payload`` what the chest carries [kg], or the torso
                of a robot without that point.

        Raises:
            ValueError: on a value that the physics or the servos cannot have.
        """
        params = {name: self._nominal[name].clone() for name in {*self._moved, *values}}
        for name, value in values.items():
            column: int | slice = slice(None)
            if name in ("slope", "payload"):
                loaded = self.points.index("chest" if "chest" in self.points else "torso")
                column = 0 if name == "slope" else loaded
            params[name][:, column] = value
        td = TensorDict(params, batch_size=[self.num_envs])
        self.env.base_env.set_physics_params(td)
        self._moved = dict(values)

    def carry_on(self, candidate: Candidate) -> None:
        """Lets newer weights of the same policy act from the coming step on."""
        self.candidate, self.actor = candidate, candidate.actor
