"""The robots side by side, and others' pushes on them: ``python -m recipes.systems.robots``."""

from ..shell import start

NAMES = ("zeroth01", "op3", "g1", "t1")
# Whose training, robot, largest jump of the base's velocity [m/s], from one to the next [s]. Of
# their public configurations; mjlab's is its default, 0.5 m/s forward and sideways.
JUMPS = (
    ("MuJoCo Playground", "g1", 2.0, (5.0, 10.0)),
    ("MuJoCo Playground", "t1", 1.0, (5.0, 10.0)),
    ("mjlab", "g1", 0.5 * 2**0.5, (1.0, 3.0)),
)


def main() -> None:
    """Prints both tables in Markdown."""
    from rich.console import Console

    from zfall.configs import compose_config
    from zfall.envs.tables import robot_of
    from zfall.evaluation.published import Jump, jumps_table, robots_table
    from zfall.evaluation.writers import markdown

    robots = [robot_of(compose_config([f"robot={name}"]).env) for name in NAMES]
    console = Console()
    jumps = [
        Jump(system=system, robot=robot, speed=speed, interval=interval)
        for system, robot, speed, interval in JUMPS
    ]
    for table in (robots_table(robots), jumps_table(robots, jumps)):
        console.print(markdown(table), markup=False, soft_wrap=True)


if __name__ == "__main__":
    start(main)
