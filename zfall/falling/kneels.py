"""On what a robot may kneel, and where poses on the knees are looked for, by robot."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from zfall.robots import ZEROTH01, Robot

Range = tuple[float, float]  # [rad]


@dataclass(frozen=True, kw_only=True)
class KneelSearch:
    """Ranges from which poses of one kind are drawn; other joints stand.

    Args:
        ranges: of joints, uniform, drawn in this order [rad].
        zero: joints that are at zero.
        same: joints that take the angle of another one.
        spread: the joints that part the legs, by the same angle and by its opposite.
        shown: joints that a table of poses has.
    """

    ranges: Mapping[str, Range]
    zero: tuple[str, ...] = ()
    same: Mapping[str, str] = field(default_factory=dict)
    spread: tuple[str, str]
    shown: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Kneels:
    """How a robot kneels.

    Args:
        regions: parts on which it may come to rest on its knees, without the side.
        searches: by name, where ``recipes.falling.kneel_pose`` looks for such poses.
    """

    regions: tuple[str, ...] = ("knee", "shin")
    searches: Mapping[str, KneelSearch] = field(default_factory=dict)


def kneels_of(robot: Robot) -> Kneels:
    """How a robot kneels, by its name in ``KNEELS``; others may rest on knees and shins."""
    return KNEELS.get(robot.name, Kneels())


# Uniform ranges of the leg joints [rad]: of the front (left) and the rear leg, or both the same.
_FRONT = {"hip_pitch": (-1.57, -0.8), "knee_pitch": (-1.2, -0.2), "ankle_pitch": (-0.5, 0.3)}
_REAR = {"hip_pitch": (0.2, 0.87), "knee_pitch": (-1.39, -0.6), "ankle_pitch": (-0.6, 0.6)}
_BOTH = {"hip_pitch": (0.2, 0.87), "knee_pitch": (-1.39, -0.9), "ankle_pitch": (-0.6, 0.69)}


def _search(left: Mapping[str, Range], right: Mapping[str, Range]) -> KneelSearch:
    legs = [(side, joint) for side in ("right", "left") for joint in _BOTH]
    return KneelSearch(
        ranges={f"left_{j}": v for j, v in left.items()}
        | {f"right_{j}": v for j, v in right.items()},
        zero=("left_ankle_roll", "right_ankle_roll"),
        same={f"right_{joint}": f"left_{joint}" for joint in _BOTH} if left is right else {},
        spread=("left_hip_roll", "right_hip_roll"),
        shown=(*(f"{side}_{joint}" for side, joint in legs), "left_hip_roll"),
    )


# To which a robot of one's own may be added.
KNEELS = {
    ZEROTH01.name: Kneels(
        searches={"half-kneel": _search(_FRONT, _REAR), "both knees": _search(_BOTH, _BOTH)}
    )
}
