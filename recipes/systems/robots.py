"""The robots side by side, and others' pushes on them: ``python -m recipes.systems.robots``."""

from ..shell import start

NAMES = ("zeroth01", "op3", "g1", "t1")


def main() -> None:
    """Prints both tables in Markdown."""
    from rich.console import Console

    from recipes.systems._published import jumps_table, robots_table
    from zfall.configs import compose_config
    from zfall.envs.tables import robot_of
    from zfall.evaluation.writers import markdown

    robots = [robot_of(compose_config([f"robot={name}"]).env) for name in NAMES]
    console = Console()
    for table in (robots_table(robots), jumps_table(robots)):
        console.print(markdown(table), markup=False, soft_wrap=True)


if __name__ == "__main__":
    start(main)
