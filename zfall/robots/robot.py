"""Robots as data: an MJCF, and the few things that it cannot say."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from zfall.robots.actuators import Stiffness
from zfall.robots.completion import CORNERS, Additions
from zfall.robots.derivation import Derived, derive
from zfall.robots.mjcf import find_mjcf, read_spec
from zfall.robots.points import PushPoint
from zfall.robots.refusals import GRAVITY, check_postures

__all__ = ["GRAVITY", "PushPoint", "Robot"]

DERIVED: Any = None  # what is left out follows from the MJCF
_TUPLES = ("joints", "feet", "foot_links", "corners", "sole_half_size", "regions", "legs",
           "mirror_keeps_sign", "mirror_signs")  # fmt: skip
_NEEDED = ("joints", "stand", "sole_half_size", "regions", "push_points", "mirror", "com_height",
           "mass")  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Robot:
    """What the framework must know of a robot.

    A name and an MJCF are enough where the MJCF has a free joint, an actuator on each hinge that
    moves, two feet and a reference pose in which the actuators keep it standing. What is left out
    then follows from the model; sensors, soles and a floor are added to it. What is declared and
    contradicts the model is refused when the robot is first compiled. An MJCF that was written for
    zfall has a sensor for every key by itself, and needs joints, soles and regions declared.

    Args:
        name: short name, stored in checkpoints.
        mjcf: path of the MJCF, of a folder with one, or ``PACKAGE:PATH``.
        joints: joint names, in the order of every vector over joints; else that of the actuators.
        stand: the joints of the standing reference pose that are not at zero [rad]; else that of
            the keyframe.
        keyframe: of the MJCF with the reference pose, where the base may lean; without ``stand``
            it is the one named ``stand`` or ``home``, or the first, else all joints are at rest.
        feet: names of the left and the right foot, as in ``feet_position/left``.
        foot_links: the links that are the left and the right foot; else the two lowest ones.
        corners: names of the corners of a sole, as in ``feet_corner_force/left/front_left``.
        sole_half_size: half the length and half the width of a sole [m].
        regions: parts of the body whose contact with the floor is told apart; the last two are
            the left and the right foot.
        region_links: links by region, in place of those that the tree suggests.
        push_points: named points at which pushes act; ``torso``, ``pelvis`` and ``chest`` are there
            by default, at centers of mass. Every link is one, too.
        mirror: for each joint, the joint on the other side; empty if the robot is not symmetric.
        mirror_keeps_sign: words in the names of joints whose angle keeps its sign when left and
            right are exchanged.
        mirror_signs: the same as a factor for each joint, 1 or -1.
        com_height: height of the center of mass above the floor in the standing pose, once the
            servos hold it [m].
        mass: total mass [kg].
        legs: the joints of the legs.
        stiffness: of the controller that motors get [N m/rad], for all or by joint; see
            ``zfall.robots.actuators``.
        held: whether the servos hold the reference pose; ``False``: they are too soft for it
            without a policy, and ``com_height`` is that of the pose itself.
        postures: other poses by name, each like ``stand``: joints that are not at zero [rad].
            What needs one names it, see ``posture``.
        gaits: by name, values of ``zfall.motions.gaits.Gait``, in place of those that suit its
            height.
        look: path of an MJCF of what the robot looks like, see ``zfall.simulation.look``; its
            own geoms are shown if ``None``.

    Raises:
        ValueError: if the MJCF is missing or no humanoid, its reference pose falls, or what is
            declared is not in it.
    """

    name: str
    mjcf: str
    joints: tuple[str, ...] = DERIVED
    stand: dict[str, float] = DERIVED
    keyframe: str | None = None
    feet: tuple[str, str] = ("left", "right")
    foot_links: tuple[str, str] | None = None
    corners: tuple[str, ...] = CORNERS
    sole_half_size: tuple[float, float] = DERIVED
    regions: tuple[str, ...] = DERIVED
    region_links: Mapping[str, tuple[str, ...]] | None = None
    push_points: dict[str, PushPoint] = DERIVED
    mirror: dict[str, str] = DERIVED
    mirror_keeps_sign: tuple[str, ...] = ()
    mirror_signs: tuple[float, ...] = ()
    com_height: float = DERIVED
    mass: float = DERIVED
    legs: tuple[str, ...] = DERIVED
    stiffness: Stiffness = None
    held: bool = True
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gaits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    look: str | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "mjcf", find_mjcf(self.mjcf))
        for name in _TUPLES:  # yaml has lists
            if isinstance(value := getattr(self, name), list):
                object.__setattr__(self, name, tuple(value))
        if self._lacking:
            self._derive()
        object.__setattr__(self, "legs", self.legs or ())
        check_postures(self.postures, self.joints)

    def _derive(self) -> None:
        derived = self.derived
        points = {**derived.push_points, **(self.push_points or {})}
        object.__setattr__(self, "push_points", points)
        object.__setattr__(self, "keyframe", derived.keyframe)
        if self.mirror is None and not self.mirror_signs:
            object.__setattr__(self, "mirror_signs", derived.mirror_signs)
        for name in (*self._lacking, "legs"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(derived, name))

    @property
    def _lacking(self) -> list[str]:
        return [name for name in _NEEDED if getattr(self, name) is None]

    def __hash__(self) -> int:
        return hash((self.name, self.mjcf))

    @cached_property
    def derived(self) -> Derived:
        """What the MJCF says of the robot.

        Raises:
            ValueError: if it is none that can be read so.
        """
        from zfall.robots.completion import speaks_our_names

        if speaks_our_names(read_spec(self.mjcf)):
            raise ValueError(
                f"{self.name} must declare {', '.join(self._lacking)}: {self.mjcf} has sensors for "
                "the keys, so that nothing is derived from it."
            )
        return derive(self)

    @property
    def additions(self) -> Additions:
        """What is added to an MJCF that lacks sensors."""
        return self.derived.additions

    @property
    def stand_position(self) -> tuple[float, ...]:
        """Standing reference pose in the order of ``joints`` [rad]."""
        return tuple(self.stand.get(joint, 0.0) for joint in self.joints)

    def posture(self, name: str) -> tuple[float, ...]:
        """A named posture in the order of ``joints`` ``(J,)`` [rad].

        Raises:
            ValueError: if the robot has none of this name.
        """
        if name not in self.postures:
            there = ", ".join(self.postures) or "none"
            raise ValueError(f"{self.name} must have a posture {name!r}; it has {there}.")
        return tuple(self.postures[name].get(joint, 0.0) for joint in self.joints)

    @property
    def impulse_unit(self) -> float:
        """Impulse of dimensionless size 1, ``m sqrt(g h0)`` [N s]."""
        return self.mass * (GRAVITY * self.com_height) ** 0.5

    @property
    def mirror_index(self) -> tuple[int, ...]:
        """Position of each joint's counterpart in ``joints``.

        Raises:
            ValueError: if left and right of the robot are not alike.
        """
        if not self.mirror:
            raise ValueError(
                f"{self.name} must be symmetric for left and right to be exchanged, it is not: "
                "symmetry=none trains it as it is."
            )
        return tuple(self.joints.index(self.mirror[joint]) for joint in self.joints)

    @property
    def mirror_sign(self) -> tuple[float, ...]:
        """Factor on each joint's angle when left and right are exchanged, 1 or -1."""
        if self.mirror_signs:
            return self.mirror_signs
        keeps = self.mirror_keeps_sign
        return tuple(1.0 if any(w in joint for w in keeps) else -1.0 for joint in self.joints)

    def index_of(self, group: str) -> tuple[int, ...]:
        """Positions in ``joints`` of those of a group: ``all`` or ``legs``.

        Raises:
            ValueError: on another name, or if the robot has none.
        """
        groups = {"all": self.joints, "legs": self.legs}
        if not groups.get(group):
            there = " or ".join(name for name, joints in groups.items() if joints)
            raise ValueError(f"joints must be {there}, got {group!r}.")
        return tuple(self.joints.index(joint) for joint in groups[group])
