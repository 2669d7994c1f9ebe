"""How hard the robot's parts meet the floor and each other."""

import math
from dataclasses import dataclass
from typing import Annotated

from zfall.values import Positive, Rule

Restitution = Annotated[float, Rule("lie between 0 and 1", lambda x: 0 < x < 1)]


@dataclass(frozen=True, kw_only=True)
class Contact:
    """A spring and a damper between two bodies that touch.

    MuJoCo scales them by the masses that meet, so they are given as those of an oscillator: a body
    that arrives with the speed v and is damped little slows down by ``2 pi frequency v`` at most.

    Args:
        frequency: of the oscillator without its damper [Hz].
        damping_ratio: 1 lets nothing rebound.
    """

    frequency: Positive
    damping_ratio: Positive

    def solref(self, physics_dt: float) -> tuple[float, float]:
        """MuJoCo's ``solref`` [s, 1].

        Args:
            physics_dt: the physics' step [s].

        Raises:
            ValueError: if the step is too long: with less than six in a radian MuJoCo's impact is
                another than the oscillator's, and it softens what is shorter than two steps.
        """
        pulse = 2.0 * math.pi * self.frequency
        longest = min(1.0 / (6.0 * pulse), 0.5 / (pulse * self.damping_ratio))
        if physics_dt > longest:
            raise ValueError(
                f"physics_dt must be at most {longest:.2g} for contacts of "
                f"{self.frequency:.4g} Hz, got {physics_dt:g}."
            )
        return 1.0 / (pulse * self.damping_ratio), self.damping_ratio


def pad(
    *,
    modulus: Positive,
    area: Positive,
    thickness: Positive,
    mass: Positive,
    restitution: Restitution,
) -> Contact:
    """The contact of a flat pad: ``frequency = sqrt(modulus area / (thickness mass)) / (2 pi)``.

    Args:
        modulus: of the pad's material, in compression [Pa].
        area: that is pressed [m2].
        thickness: of the pad [m].
        mass: that it stops [kg].
        restitution: speed after over speed before the impact.
    """
    bounce = math.log(restitution)
    stiffness = modulus * area / thickness
    return Contact(
        frequency=math.sqrt(stiffness / mass) / (2.0 * math.pi),
        damping_ratio=-bounce / math.hypot(math.pi, bounce),
    )
