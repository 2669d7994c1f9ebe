"""The pushes of the three published systems on this robot: ``python -m recipes.systems.pushes``."""

from typing import TYPE_CHECKING

from ..shell import start

if TYPE_CHECKING:
    from zfall.evaluation.published import PublishedPush

# Mass [kg] and height of the center of mass [m]. Of the iCub the mass is published, the height our
# estimate; the Zeroth-01 is the same robot.
ICUB, ATALANTE, ZEROTH = (33.0, 0.53), (135.0, 0.95), (3.349, 0.220)
# System, what was done with it and its section, body, peak [N], duration [s], profile.
PUSHES = (
    ("iCub", "training (IV-D)", ICUB, 200.0, 0.2, "rectangular"),
    ("iCub", "recovered in all directions (VI-C)", ICUB, 300.0, 0.2, "rectangular"),
    ("iCub", "recovered in some directions (VI-C)", ICUB, 400.0, 0.2, "rectangular"),
    ("Atalante", "training (IV-A.4)", ATALANTE, 800.0, 0.4, "gaussian"),
    ("Atalante", "recovered fore and aft, 190 N s (V-C)", ATALANTE, 475.0, 0.4, "rectangular"),
    ("Zeroth-01", "stage easy (3)", ZEROTH, 20.0, 0.1, "rectangular"),
    ("Zeroth-01", "stage medium (3)", ZEROTH, 40.0, 0.1, "rectangular"),
    ("Zeroth-01", "stage hard (3)", ZEROTH, 60.0, 0.1, "rectangular"),
    ("Zeroth-01", "stage kneel trigger (3)", ZEROTH, 100.0, 0.1, "rectangular"),
)


def published() -> list["PublishedPush"]:
    """The pushes of the papers."""
    from zfall.evaluation.published import Body, PublishedPush

    return [
        PublishedPush(
            system=system,
            what=what,
            body=Body(mass=mass, com_height=height),
            force=force,
            duration=duration,
            profile=profile,
        )
        for system, what, (mass, height), force, duration, profile in PUSHES
    ]


def main() -> None:
    """Prints their table in Markdown."""
    from rich.console import Console

    from zfall.evaluation.published import published_table
    from zfall.evaluation.writers import markdown
    from zfall.robots import ZEROTH01

    table = published_table(ZEROTH01, published())
    Console().print(markdown(table), markup=False, soft_wrap=True)


if __name__ == "__main__":
    start(main)
