"""How an episode begins."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.humanoid import START_KEYS, STATE_KEYS, HumanoidEnv
from zfall.envs.motions import load_motions
from zfall.envs.rotations import rotate, turned
from zfall.envs.transforms.values import per_world, reset_rows, two_numbers

SEEN_KEYS = ("target", "feet_force", "com_velocity")  # what a policy sees and no state tells
OF_JOINTS = ("joint_position", "joint_velocity", "target")


class NoisyStart(Transform):
    """Starts episodes in the standing pose with Gaussian noise, over the floor or on it.

    Writes ``("start", "joint_position")`` [rad] and ``("start", "joint_velocity")`` [rad/s]
    ``(N, J)`` for the reset of the base env; angles are clamped to the joint ranges. With a
    clearance also ``("start", "clearance")`` ``(N, 1)`` [m].

    Args:
        env: the base env.
        joint_position: standard deviation of each angle [rad].
        joint_velocity: standard deviation of each speed [rad/s].
        clearance: smallest and largest height of the lowest corner of the soles above the floor
            [m], uniform; what is drawn below 0 is 0. On the floor if ``null``.

    Raises:
        ValueError: on a negative standard deviation, or a clearance that is no range.
    """

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        joint_position: float = 0.0,
        joint_velocity: float = 0.0,
        clearance: Sequence[float] | None = None,
    ):
        super().__init__()
        for name, std in (("joint_position", joint_position), ("joint_velocity", joint_velocity)):
            if std < 0:
                raise ValueError(f"{name} must not be negative, got {std}.")
        self.clearance = None if clearance is None else list(two_numbers("clearance", clearance))
        if self.clearance is not None and not self.clearance[0] <= self.clearance[1]:
            raise ValueError(f"clearance must be [smallest, largest], got {list(self.clearance)}.")
        self.joint_position, self.joint_velocity = joint_position, joint_velocity
        self.rng, self.stand, self.range = env.rng, env.stand_position, env.joint_range
        self.num_envs = env.num_envs

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        # All rows are drawn, so that the random stream does not depend on who fell.
        noise = torch.randn(2, self.num_envs, len(self.stand), generator=self.rng)
        low, high = self.range.unbind(-1)
        angle = self.stand + per_world(self.joint_position, 2) * noise[0]
        tensordict["start", "joint_position"] = torch.clamp(angle, low, high)
        tensordict["start", "joint_velocity"] = per_world(self.joint_velocity, 2) * noise[1]
        if self.clearance is not None:
            least, most = (per_world(bound, 2) for bound in self.clearance)
            u = torch.rand(self.num_envs, 1, generator=self.rng)
            tensordict["start", "clearance"] = torch.clamp_min(least + (most - least) * u, 0.0)
        return tensordict


class ScriptedStart(Transform):
    """Starts every world in a state given beforehand.

    Writes the keys ``("start", NAME)`` for the reset of the base env, NAME being one of
    ``zfall.envs.humanoid.START_KEYS``, from ``states``, which may be changed between episodes.

    Args:
        env: the base env.
        states: by name, values ``(N, ...)`` for each world.

    Raises:
        ValueError: on a name that is not one of ``START_KEYS``.
    """

    def __init__(self, env: HumanoidEnv, *, states: dict[str, Tensor]):
        super().__init__()
        unknown = sorted(set(states) - set(START_KEYS))
        if unknown:
            raise ValueError(f"states must be of {', '.join(START_KEYS)}, got {unknown[0]}.")
        self.states, self.num_envs = states, env.num_envs

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        for name, value in self.states.items():
            tensordict["start", name] = value
        return tensordict


class ReferenceStart(Transform):
    """Starts episodes in the midst of reference motions, with Gaussian noise on the joints.

    A motion and its phase are drawn uniformly; where the base is then is the origin, and the way
    it faces is that of x, or any if ``heading``. The lowest corner of the soles is put on the
    floor: in the motions it is there, and noise would push a sole into it otherwise.

    Writes, for the reset of the base env, ``("start", NAME)`` ``(N, ...)`` for all ``STATE_KEYS``
    but ``base_position``; angles are clamped to the joint ranges.

    Args:
        env: the base env.
        motions: names of motions, see ``docs/gaits.md``; all if ``None``.
        joint_position: standard deviation of each angle [rad].
        joint_velocity: standard deviation of each speed [rad/s].
        heading: whether to turn the robot by an angle drawn uniformly.

    Raises:
        ValueError: on an unknown motion or none, a negative standard deviation, or a robot
            without motions.

    Source: Duburcq et al., "Reactive stepping for humanoid robots using reinforcement learning",
    IROS 2022, section IV-B. The motions are our own, the deviations of the noise not published.
    """

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        motions: Sequence[str] | None = None,
        joint_position: float = 0.0,
        joint_velocity: float = 0.0,
        heading: bool = False,
    ):
        super().__init__()
        for name, std in (("joint_position", joint_position), ("joint_velocity", joint_velocity)):
            if std < 0:
                raise ValueError(f"{name} must not be negative, got {std}.")
        there = load_motions(env.robot)
        names = list(there if motions is None else motions)
        unknown = [name for name in names if name not in there]
        if unknown or not names:
            got = unknown[0] if unknown else "none"
            raise ValueError(f"motions must be of {', '.join(there)}, got {got}.")
        self.joint_position, self.joint_velocity = joint_position, joint_velocity
        self.heading = heading
        self.rng, self.range, self.num_envs = env.rng, env.joint_range, env.num_envs
        chosen = [there[name].states for name in names]
        self.count = torch.tensor([len(states["joint_position"]) for states in chosen])
        self.first = self.count.cumsum(0) - self.count
        keys = [key for key in STATE_KEYS if key != "base_position"]
        states = {
            key: torch.from_numpy(np.concatenate([states[key] for states in chosen]))
            for key in keys
        }
        ahead = rotate(states["base_orientation"], torch.tensor([[1.0, 0.0, 0.0]]))
        _turn(states, -torch.atan2(ahead[:, 1], ahead[:, 0]))
        self.sizes = {key: states[key].shape[-1] for key in keys}
        self.table = torch.cat([states[key] for key in keys], -1)  # one look-up for all

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        if tensordict is None:
            tensordict = TensorDict(batch_size=[self.num_envs])
        # All rows are drawn, so that the random stream does not depend on who fell.
        motion = torch.randint(len(self.count), (self.num_envs,), generator=self.rng)
        phase, angle = torch.rand(2, self.num_envs, generator=self.rng)
        row = self.first[motion] + (phase * self.count[motion]).long()
        values = self.table.index_select(0, row).split(list(self.sizes.values()), -1)
        start = dict(zip(self.sizes, values, strict=True))
        if self.heading:
            _turn(start, 2.0 * torch.pi * angle)
        joints = start["joint_position"]
        noise = torch.randn(2, *joints.shape, generator=self.rng)
        low, high = self.range.unbind(-1)
        joints = joints + per_world(self.joint_position, 2) * noise[0]
        start["joint_position"] = torch.clamp(joints, low, high)
        start["joint_velocity"] += per_world(self.joint_velocity, 2) * noise[1]
        for name, value in start.items():
            tensordict["start", name] = value
        return tensordict


class FallingStart(Transform):
    """Starts episodes in the midst of falls, states recorded from a policy that was pushed.

    Writes ``("start", NAME)`` ``(N, ...)`` for all ``STATE_KEYS`` in a share of the worlds; the
    others begin as what comes before it in the table says. ``python -m recipes.falls`` records.
    Of these worlds it also writes what was seen then, ``SEEN_KEYS``, if the bank has them: the
    target that the servos had, as ``("start", "target")`` ``(N, J)`` [rad], not a number in the
    other worlds; the forces on the feet, which depend on it and on the push; and the velocity of
    the center of mass, which sensors tell of the begin of a physics step. A policy that sees at
    first what it never sees later, the reference as its target, does something else there. Comes
    before what reads these.

    Args:
        env: the base env.
        bank: file with arrays ``(K, ...)`` for all ``STATE_KEYS``; ``None``: that of the robot.
        share: of the episodes that begin in a fall.
        pushed: whether what is left of a push at that moment goes on, at the torso, where those
            of the bank must have been (``recipes.falls 'points=[torso]'``); ``falling_impulse``
            ``(N, 3)`` [N s; world] is what is still to come. The bank then has ``push_force``
            ``(K, 3)`` [N; world], ``push_left`` ``(K, 1)`` [s] and all ``SEEN_KEYS``, too.
            ``falling_speed`` ``(N, 1)`` [m/s] is how fast the center of mass will move along the
            ground once all of the push has acted, reckoned at the begin of the episode.
        alike: worlds in a row that begin in the same state, if they begin in the same step.

    Raises:
        ValueError: if the file is missing, is of another robot, lacks pushes that are to go on or
            numbers, if the share is not in (0, 1], ``alike`` is no number of worlds, or something
            that reads what it writes stands before it.
    """

    force: Tensor
    left: Tensor
    speed: Tensor

    def __init__(
        self,
        env: HumanoidEnv,
        *,
        bank: str | None = None,
        share: float = 1.0,
        pushed: bool = False,
        alike: int = 1,
    ):
        super().__init__()
        if type(alike) is not int or alike < 1:
            raise ValueError(f"alike must be a whole number, at least 1, got {alike}.")
        if not 0 < share <= 1:
            raise ValueError(f"share must lie in (0, 1], got {share}.")
        if pushed and bank is None:
            raise ValueError(
                "bank must name a file of recipes.falls 'points=[torso]' for pushed=true, "
                "got null: the robot's own has pushes at the pelvis, too."
            )
        own = Path(env.robot.mjcf).with_name(f"{env.robot.name}_falls.npz")
        path = own if bank is None else Path(bank)
        if not path.is_file():
            raise ValueError(f"bank must be a file that recipes.falls wrote, there is no {path}.")
        rest = ("push_force", "push_left") if pushed else ()
        with np.load(path) as file:
            seen = SEEN_KEYS if pushed or all(key in file for key in SEEN_KEYS) else ()
            lacking = [key for key in (*STATE_KEYS, *rest, *seen) if key not in file]
            if lacking:
                raise ValueError(
                    f"bank must be a file that recipes.falls wrote, {path} lacks {lacking[0]}: "
                    "record it again."
                )
            states = {
                key: torch.from_numpy(file[key]).float().flatten(1)
                for key in (*STATE_KEYS, *rest, *seen)
            }
        of_joints = [value.shape[1] for key, value in states.items() if key in OF_JOINTS]
        if set(of_joints) != {len(env.stand_position)}:
            raise ValueError(f"bank must be of {env.robot.name}, {path} has other joints.")
        count = len(states["joint_position"])
        for key, value in states.items():
            if len(value) != count or not value.isfinite().all():
                raise ValueError(
                    f"bank must hold {count} rows of numbers under every key, as for "
                    f"joint_position; {path} does not for {key}: record it again."
                )
        self.share, self.pushed, self.alike = share, pushed, alike
        self.num_envs, self.rng = env.num_envs, env.rng
        self.sizes = {key: value.shape[-1] for key, value in states.items()}
        self.table = torch.cat(list(states.values()), -1)
        self.seen = dict.fromkeys(seen[1:], torch.empty(0))  # but the target, of the start
        base = torch.tensor(env.simulation.model.key("stand").qpos).float()
        self.stand = {  # of the other worlds, whose soles are put on the floor
            "base_position": torch.full((3,), torch.nan),
            "base_orientation": base[3:7],
            "joint_position": env.stand_position,
        }
        if not pushed:
            return
        self.torso, self.add_force = env.push_target("torso"), env.add_force
        self.control_dt, self.physics_dt = env.control_dt, env.physics_dt
        self.number = torch.arange(env.substeps)
        self.register_buffer("force", torch.zeros(env.num_envs, 3))
        self.register_buffer("left", torch.zeros(env.num_envs, 1))
        self.mass = env.mass
        self.register_buffer("speed", torch.zeros(env.num_envs, 1))

    def attach(self, transforms: Mapping[str, Transform]) -> None:
        """Looks whether what reads ``SEEN_KEYS`` comes after it."""
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
        # All rows are drawn, so that the random stream does not depend on who fell.
        count = -(-self.num_envs // self.alike)
        row = torch.randint(len(self.table), (count,), generator=self.rng)
        chance = torch.rand(count, 1, generator=self.rng)
        siblings = torch.arange(self.num_envs) // self.alike
        row, chance = row[siblings], chance[siblings]
        falls = chance < per_world(self.share, 2)
        drawn = self.table.index_select(0, row).split(list(self.sizes.values()), -1)
        values = dict(zip(self.sizes, drawn, strict=True))
        for name in self.seen:
            self.seen[name] = torch.where(falls, values.pop(name), torch.nan)
        target = values.pop("target", None)
        if target is not None:
            tensordict["start", "target"] = torch.where(falls, target, torch.nan)
        if self.pushed:
            new = reset_rows(tensordict)[:, None]
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
            self.speed = torch.where(reset_rows(tensordict)[:, None], speed, self.speed)
        for name, value in self.seen.items():
            there = tensordict_reset[name]
            seen = value.view_as(there)
            tensordict_reset.set(name, torch.where(seen.isnan(), there, seen))
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
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
        return self.add_force(tensordict, self.torso, acts, rows)


def _turn(states: dict[str, Tensor], angle: Tensor) -> None:
    """Turns the base and its velocity by ``angle`` ``(K,)`` [rad] about the world's up axis."""
    cos, sin = angle.cos(), angle.sin()
    x, y, z = states["base_linear_velocity"].unbind(-1)
    states["base_linear_velocity"] = torch.stack([cos * x - sin * y, sin * x + cos * y, z], -1)
    states["base_orientation"] = turned(states["base_orientation"], angle)
