"""Starts in the midst of recorded falls."""

from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import STATE_KEYS, HumanoidEnv
from zfall.envs.transforms.base_env import base_env_of, needs_env, streams_of
from zfall.envs.transforms.values import per_world, reset_rows
from zfall.falling.banks import ESTIMATES, PUSH_KEYS, SEEN_KEYS, load_bank
from zfall.falling.files import own_file
from zfall.fingerprints import reads_files
from zfall.values import Count, FractionAboveZero


@reads_files(
    lambda values, robot: [Path(values.get("bank") or own_file(robot, "falls.npz"))], "bank"
)
class FallingStart(Transform):
    """Starts a share of the episodes in states of falls that ``recipes.falling.falls`` recorded.

    In these worlds it writes ``("start", NAME)`` ``(N, ...)`` for all ``STATE_KEYS``; the others
    start as earlier transforms of the table say. If the bank has ``SEEN_KEYS``, it also restores
    what the policy saw in that moment: the target of the servos, as ``("start", "target")``
    ``(N, J)`` [rad], NaN in the other worlds; the forces on the feet; and the velocity of the
    center of mass, which sensors give at the begin of a physics step. Without them the first
    observation differs from all later ones, and the policy acts differently. Comes before what
    reads these. Where the bank has ``ESTIMATES``, the filters of tilt and of joint speeds begin
    with what they had made of the motion, not with the truth: in a fall they are late.

    Keys: reads and writes ``("start", NAME)``; writes ``("start_measured", KEY)`` for these
    filters; writes ``falling_impulse`` and ``falling_speed`` if ``pushed``, and ``feet_force`` and
    ``com_velocity`` at a reset.

    Args:
        env: the base env.
        bank: file with arrays ``(K, ...)`` for all ``STATE_KEYS``; ``None``: that of the robot.
        share: of the episodes that begin in a fall.
        pushed: whether the rest of the push acts, at the torso, where those of the bank must have
            been (``recipes.falling.falls 'points=[torso]'``). The bank then needs ``push_force``
            ``(K, 3)`` [N; world], ``push_left`` ``(K, 1)`` [s] and all ``SEEN_KEYS``.
            ``falling_impulse`` ``(N, 3)`` [N s; world] is what is still to come. ``falling_speed``
            ``(N, 1)`` [m/s] is how fast the center of mass will move along the ground once all of
            the push has acted, computed at the begin of the episode.
        alike: number of consecutive worlds that begin in the same state, if they begin in the same
            step.

    Raises:
        ValueError: if the file is missing, is of another robot, or lacks numbers or the pushes; if
            the share is not in (0, 1] or ``alike`` is no number of worlds; or if a transform that
            reads what it writes comes earlier in the table.
    """

    replaced_in_batteries = True  # which have starts and pushes of their own
    mirror_signs: ClassVar[Mapping[str, tuple[float, ...]]] = {
        "falling_impulse": (1.0, -1.0, 1.0),
        "falling_speed": (1.0,),
    }

    force: Tensor
    left: Tensor
    speed: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        bank: str | None = None,
        share: FractionAboveZero = 1.0,
        pushed: bool = False,
        alike: Count = 1,
    ):
        super().__init__()
        needs_env(self, env, "the begin of episodes")
        if type(alike) is not int or alike < 1:
            raise ValueError(f"alike must be a whole number, at least 1, got {alike}.")
        if not 0 < share <= 1:
            raise ValueError(f"share must lie in (0, 1], got {share}.")
        if pushed and bank is None:
            raise ValueError(
                "bank must name a file of recipes.falling.falls 'points=[torso]' for pushed=true, "
                "got null: the robot's own has pushes at the pelvis, too."
            )
        path = own_file(env.robot, "falls.npz") if bank is None else Path(bank)
        rest = PUSH_KEYS if pushed else ()
        states = load_bank(path, env.robot, needs=(*PUSH_KEYS, *SEEN_KEYS) if pushed else ())
        seen = SEEN_KEYS if all(key in states for key in SEEN_KEYS) else ()
        self.estimates = {name: key for name, key in ESTIMATES.items() if name in states}
        states = {key: states[key] for key in (*STATE_KEYS, *rest, *seen, *self.estimates)}
        self.share, self.pushed, self.alike = share, pushed, alike
        self.num_envs = env.num_envs
        self.sizes = {key: value.shape[-1] for key, value in states.items()}
        self.table = torch.cat(list(states.values()), -1)
        self.seen = dict.fromkeys(seen[1:], torch.empty(0))  # the target is part of the start
        base = torch.tensor(env.simulation.model.key("stand").qpos).float()
        self.stand = {  # of the other worlds, whose soles are put on the floor
            "base_position": torch.full((3,), torch.nan),
            "base_orientation": base[3:7],
            "joint_position": env.stand_position,
        }
        if not pushed:
            return
        self.torso = env.push_target("torso")
        self.control_dt, self.physics_dt = env.control_dt, env.physics_dt
        self.number = torch.arange(env.substeps)
        self.register_buffer("force", torch.zeros(env.num_envs, 3))
        self.register_buffer("left", torch.zeros(env.num_envs, 1))
        self.mass = env.mass
        self.register_buffer("speed", torch.zeros(env.num_envs, 1))

    def attach(self, transforms: Mapping[str, Transform]) -> None:
        """Checks that transforms that read ``SEEN_KEYS`` come after it."""
        own = next(name for name, t in transforms.items() if t is self)
        for name, transform in transforms.items():
            if transform is self:
                return
            late = [key for key in self.seen if key in (transform.in_keys or ())]
            if late:
                raise ValueError(
                    f"transforms.{own} must come before {name}, which reads {late[0]}: give it "
                    f"before: {name}."
                )

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        # The first of the worlds that begin alike draws for all of them.
        worlds = torch.arange(self.num_envs)
        first = worlds - worlds % self.alike
        rows = torch.zeros(self.num_envs, dtype=torch.bool)
        rows[first[reset_rows(tensordict)]] = True
        row = streams_of(self).integers(len(self.table), (), rows)[first]
        chance = streams_of(self).uniform((1,), rows)[first]
        falls = chance < per_world(self.share, 2)
        drawn = self.table.index_select(0, row).split(list(self.sizes.values()), -1)
        values = dict(zip(self.sizes, drawn, strict=True))
        for name in self.seen:
            self.seen[name] = torch.where(falls, values.pop(name), torch.nan)
        for name, key in self.estimates.items():
            tensordict["start_measured", key] = torch.where(falls, values.pop(name), torch.nan)
        target = values.pop("target", None)
        if target is not None:
            tensordict["start", "target"] = torch.where(falls, target, torch.nan)
        if self.pushed:
            new = reset_rows(tensordict, self)[:, None]
            for name in ("force", "left"):
                value = torch.where(falls, values.pop(f"push_{name}"), 0.0)
                setattr(self, name, torch.where(new, value, getattr(self, name)))
        for name, value in values.items():
            there = tensordict.get(("start", name), None)
            if there is None:
                there = self.stand.get(name, torch.zeros_like(value)).expand_as(value)
            tensordict["start", name] = torch.where(falls, value, there)
        return tensordict

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        if self.pushed:
            next_tensordict.set("falling_impulse", self.force * self.left)
            next_tensordict.set("falling_speed", self.speed)
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if self.pushed:
            gained = self.force * self.left / self.mass
            speed = (tensordict_reset["com_velocity"] + gained)[:, :2].norm(dim=-1, keepdim=True)
            self.speed = torch.where(reset_rows(tensordict, self)[:, None], speed, self.speed)
        for name, value in self.seen.items():
            there = tensordict_reset[name]
            seen = value.view_as(there)
            tensordict_reset.set(name, torch.where(seen.isnan(), there, seen))
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        base_env_of(self)
        if self.pushed:
            observation_spec["falling_impulse"] = Unbounded((*observation_spec.shape, 3))
            observation_spec["falling_speed"] = Unbounded((*observation_spec.shape, 1))
        return observation_spec

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        # Without keys of the inverse pass: they would place it before the starts that it replaces.
        if not self.pushed or not (self.left > 0).any():
            return tensordict
        rows = (self.left[:, 0] > 0).nonzero()[:, 0]
        steps = (self.left[rows] / self.physics_dt).round()
        acts = (self.number < steps)[..., None] * self.force[rows, None]
        self.left = (self.left - self.control_dt).clamp_min(0.0)
        return base_env_of(self).add_force(tensordict, self.torso, acts, rows)
