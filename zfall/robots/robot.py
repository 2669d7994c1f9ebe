"""Robots as data. A second robot is one more MJCF and one more file with a ``Robot``."""

from collections.abc import Mapping
from dataclasses import dataclass, field

GRAVITY = 9.81  # [m/s2], MuJoCo's default, which the assets keep


@dataclass(frozen=True, kw_only=True)
class PushPoint:
    """A point fixed to a link, at which a force may act.

    Args:
        body: name of the link; or
        site: name of a site of the MJCF, the point itself.
        offset: from the link's center of mass, in the axes of the root link [m]. ``None``
            stands for the origin of the link's own frame, a joint of a limb for instance. Not
            with ``site``.
    """

    body: str | None = None
    site: str | None = None
    offset: tuple[float, float, float] | None = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Robot:
    """What the framework must know of a robot besides its MJCF.

    Args:
        name: short name, stored in checkpoints.
        mjcf: path of an MJCF that compiles by itself and has a sensor for every key of the env.
        joints: joint names, in the order of every vector over joints.
        stand: the joints of the standing reference pose that are not at zero [rad].
        feet: names of the left and the right foot, as in ``feet_position/left``.
        corners: names of the corners of a sole, as in ``feet_corner_force/left/front_left``.
        sole_half_size: half the length and half the width of a sole [m].
        regions: parts of the body whose contact with the floor is told apart; the last two are
            the left and the right foot.
        push_points: named points at which pushes act.
        mirror: for each joint, the joint on the other side.
        mirror_keeps_sign: words in the names of joints whose angle keeps its sign when left and
            right are exchanged.
        com_height: height of the center of mass above the floor in the standing pose [m].
        mass: total mass [kg].
        legs: the joints of the legs.
        postures: other poses by name, each like ``stand``: joints that are not at zero [rad].
            What needs one names it, see ``posture``.
        look: path of an MJCF of what the robot looks like, see ``zfall.simulation.look``; its
            own geoms are shown if ``None``.
    """

    name: str
    mjcf: str
    joints: tuple[str, ...]
    stand: dict[str, float]
    feet: tuple[str, str]
    corners: tuple[str, ...]
    sole_half_size: tuple[float, float]
    regions: tuple[str, ...]
    push_points: dict[str, PushPoint]
    mirror: dict[str, str]
    mirror_keeps_sign: tuple[str, ...]
    com_height: float
    mass: float
    legs: tuple[str, ...] = ()
    postures: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    look: str | None = None

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
        """Position of each joint's counterpart in ``joints``."""
        return tuple(self.joints.index(self.mirror[joint]) for joint in self.joints)

    @property
    def mirror_sign(self) -> tuple[float, ...]:
        """Factor on each joint's angle when left and right are exchanged, 1 or -1."""
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
