"""Points of a robot at which forces act."""

from dataclasses import dataclass


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
