"""What other frameworks observe, term by term, as they define it.

A term is a class: its values come from the yaml, and it is called with what is ``Seen`` in a step.
It keeps nothing from step to step. Your own is such a class, named by ``_target_``. Conventions are
those of the packages Isaac Lab 2.3.2 (``isaaclab``), mjlab 1.6.0, MuJoCo Playground 0.2.0
(``playground``) and ksim 0.2.10, read in their sources.

Positions and velocities are those at the end of the control step. MuJoCo's ``sensordata``, which
Playground and mjlab's ``builtin_sensor`` read, describe the state one physics step earlier.
"""

from collections.abc import Mapping, Sequence
from math import tau
from typing import Annotated, Literal

import torch
from torch import Tensor

from zfall.envs.transforms.foreign.seen import Seen
from zfall.rotations import rotate, rotate_inverse
from zfall.values import Name, Names, NotNegative, Positive, Rule

Numbers = Annotated[Sequence[float], Rule("hold at least one number", lambda x: len(x) > 0)]


class BaseLinearVelocity:
    """Velocity of the base ``(N, 3)`` [m/s].

    Args:
        frame: whose axes: those of the ``base`` or of the ``world``.
        point: of which point of the base link: its ``origin``, its ``center_of_mass``, or one at
            ``[x, y, z]`` in its axes [m]. At c it is ``v + R (w x c)``.

    Raises:
        ValueError: on a point of another length.

    Source: ``base_lin_vel``. In mjlab it is that of the link's origin
    (``root_link_lin_vel_b``), in Isaac Lab that of its center of mass (``root_lin_vel_b`` is
    ``root_com_lin_vel_b``). Playground's ``local_linvel`` is a velocimeter at the site of the
    IMU, of the G1 ``[0.04525, 0.0, -0.08339]``. ksim's ``BaseLinearVelocityObservation`` is in the
    world's axes unless ``in_robot_frame``.
    """

    reads = ("base_linear_velocity", "base_angular_velocity", "base_orientation")

    def __init__(
        self,
        *,
        frame: Literal["base", "world"] = "base",
        point: Literal["origin", "center_of_mass"] | Numbers = "origin",
    ):
        self.frame, self.point = frame, point
        if not isinstance(point, str) and len(point) != 3:
            raise ValueError(f"point must be [x, y, z], got {len(point)} numbers.")

    def __call__(self, seen: Seen) -> Tensor:
        turn = seen["base_orientation"]
        velocity = seen["base_linear_velocity"]
        if self.point != "origin":
            spin = seen["base_angular_velocity"]
            at = seen.base_com if self.point == "center_of_mass" else torch.tensor(list(self.point))
            velocity = velocity + rotate(turn, torch.linalg.cross(spin, at[None].to(spin)))
        return velocity if self.frame == "world" else rotate_inverse(turn, velocity)


class BaseAngularVelocity:
    """Angular velocity of the base ``(N, 3)`` [rad/s].

    Args:
        frame: whose axes: those of the ``base``, as a gyro has them, or of the ``world``;
            ``base_turned_back`` are those of the base, turned by its inverse orientation once more.

    Source: ``base_ang_vel`` of Isaac Lab and mjlab, ``gyro`` of Playground. ksim's
    ``BaseAngularVelocityObservation`` reads ``qvel[3:6]``, which MuJoCo has in the base's axes
    already: that is ``base``. With ``in_robot_frame`` it turns it once more: ``base_turned_back``.
    """

    reads = ("base_angular_velocity", "base_orientation")

    def __init__(self, *, frame: Literal["base", "world", "base_turned_back"] = "base"):
        self.frame = frame

    def __call__(self, seen: Seen) -> Tensor:
        spin = seen["base_angular_velocity"]
        turns = {"world": rotate, "base_turned_back": rotate_inverse}
        if self.frame not in turns:
            return spin
        return turns[self.frame](seen["base_orientation"], spin)


class ProjectedGravity:
    """Direction of gravity in the base's axes ``(N, 3)``, (0, 0, -1) upright.

    Source: ``projected_gravity`` of Isaac Lab and mjlab, ``gravity`` of Playground: all of length
    1. ksim's ``ProjectedGravityObservation`` is in m/s2: ``scale: 9.81``.
    """

    reads = ("projected_gravity",)

    def __call__(self, seen: Seen) -> Tensor:
        return seen["projected_gravity"]


class Command:
    """A command that stays as it is ``(N, size)``.

    Args:
        value: its numbers, as the framework has them: forward and sideways velocity [m/s] and rate
            of yaw [rad/s] of a walker of Isaac Lab, mjlab or Playground.

    Source: ``generated_commands`` of Isaac Lab and mjlab, ``command`` of Playground. A battery
    pushes a robot that stands: (0, 0, 0).
    """

    reads = ()

    def __init__(self, *, value: Numbers):
        self.value = torch.tensor(list(value), dtype=torch.float32)

    def __call__(self, seen: Seen) -> Tensor:
        return self.value.expand(len(seen.steps), -1)


class JointPosition:
    """Angles of joints ``(N, A)`` [rad].

    Args:
        relative: from the reference, or else from the zero of the joint.
        joints: names, in their order; the policy's own if left out.

    Source: ``joint_pos_rel`` of Isaac Lab and mjlab, ``qpos[7:] - default_pose`` of Playground.
    ksim's ``JointPositionObservation`` is ``qpos[7:]``: ``relative: false``.
    """

    reads = ("joint_position",)

    def __init__(self, *, relative: bool = True, joints: Names | None = None):
        self.relative, self.joints = relative, joints

    def __call__(self, seen: Seen) -> Tensor:
        index = seen.places(self.joints)
        angles = seen["joint_position"][:, index]
        return angles - seen.reference[index] if self.relative else angles


class JointVelocity:
    """Speeds of joints ``(N, A)`` [rad/s].

    Args:
        joints: names, in their order; the policy's own if left out.

    Source: ``joint_vel_rel`` of Isaac Lab and mjlab, whose default velocity is 0; ``qvel[6:]`` of
    Playground and ksim.
    """

    reads = ("joint_velocity",)

    def __init__(self, *, joints: Names | None = None):
        self.joints = joints

    def __call__(self, seen: Seen) -> Tensor:
        return seen["joint_velocity"][:, seen.places(self.joints)]


class PreviousAction:
    """An action of the policy before this step ``(N, A)``, as it came from it; 0 at the start.

    Args:
        steps: how many control steps ago it was decided.

    Source: ``last_action`` of Isaac Lab and mjlab is the action of the step just taken: 1.
    Playground's training makes its observation before it stores the action as ``last_act``, so that
    the policy sees the one before that: 2. Its sim2sim scripts, which play its policies, show 1.
    """

    reads = ()

    def __init__(self, *, steps: Literal[1, 2] = 1):
        self.steps = steps

    def __call__(self, seen: Seen) -> Tensor:
        return seen.actions[:, self.steps - 1]


class GaitClock:
    """Phases of a gait that runs by the clock: each function of every foot's phase, then the next.

    ``phase = 2 pi frequency t + offset``, with t the time since the reset, ``late`` steps ago.

    Args:
        frequency: of the gait [Hz].
        offsets: phase of each foot at the start [rad].
        functions: of the phases, in their order.
        late: control steps by which the phase lags behind.
        standing: phase of all feet from the first step on, for a command to stand [rad]; ``null``:
            the clock runs.

    Source: ``phase`` of Playground's joysticks (``[cos, sin]`` of two feet half a period apart).
    In training it moves on after the observation is made: ``late: 1``; in the sim2sim scripts
    before the next one. Under a command below 0.01 it is pi: ``standing: 3.14159265``.
    ``unitree_rl_gym`` has sine and cosine of one phase:
    ``offsets: [0], functions: [sin, cos]``.
    """

    reads = ()

    def __init__(
        self,
        *,
        frequency: Positive,
        offsets: Numbers = (0.0, tau / 2),
        functions: Sequence[Literal["cos", "sin"]] = ("cos", "sin"),
        late: Literal[0, 1] = 0,
        standing: float | None = None,
    ):
        self.frequency, self.late, self.standing = frequency, late, standing
        self.offsets = torch.tensor(list(offsets), dtype=torch.float64)
        self.functions = [{"cos": torch.cos, "sin": torch.sin}[name] for name in functions]

    def __call__(self, seen: Seen) -> Tensor:
        steps = (seen.steps - self.late).clamp_min(0).double()
        phase = tau * self.frequency * seen.control_dt * steps + self.offsets
        if self.standing is not None:
            phase = torch.where(steps > 0, self.standing, phase)
        return torch.cat([function(phase) for function in self.functions], -1).float()


class EpisodeTime:
    """Time since the reset ``(N, 1)`` [s].

    Args:
        before: of a clock that does not begin at 0 [s].

    Source: ``TimestepObservation`` of ksim.
    """

    reads = ()

    def __init__(self, *, before: NotNegative = 0.0):
        self.before = before

    def __call__(self, seen: Seen) -> Tensor:
        return (seen.steps * seen.control_dt + self.before).float()


class Quantity:
    """Any quantity of ours ``(N, size)``, flattened: see the reference of quantities.

    Args:
        name: its key, ``feet_contact`` or ``base_orientation`` (w, x, y, z) for instance.
    """

    def __init__(self, *, name: Name):
        self.name, self.reads = name, (name,)

    def __call__(self, seen: Seen) -> Tensor:
        return seen[self.name].flatten(1)


TERMS: Mapping[str, type] = {
    "base_linear_velocity": BaseLinearVelocity,
    "base_angular_velocity": BaseAngularVelocity,
    "projected_gravity": ProjectedGravity,
    "command": Command,
    "joint_position": JointPosition,
    "joint_velocity": JointVelocity,
    "previous_action": PreviousAction,
    "gait_clock": GaitClock,
    "episode_time": EpisodeTime,
    "quantity": Quantity,
}
"""By the name that the yaml of a policy has for them."""
