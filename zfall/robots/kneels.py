"""Where poses on the knees are looked for."""

from collections.abc import Mapping
from dataclasses import dataclass, field

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
