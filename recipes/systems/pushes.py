"""The pushes of the three published systems on this robot: ``python -m recipes.systems.pushes``."""

from ..shell import start


def main() -> None:
    """Prints their table in Markdown."""
    from rich.console import Console

    from recipes.systems._published import published_table
    from zfall.evaluation.writers import markdown
    from zfall.robots import ZEROTH01

    Console().print(markdown(published_table(ZEROTH01)), markup=False, soft_wrap=True)


if __name__ == "__main__":
    start(main)
