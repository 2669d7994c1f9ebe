"""What a person at the shell is told: commands to type next, paths as short as they can be."""

import sys
from contextlib import suppress
from pathlib import Path

INSTALLED = (Path(__file__).parent / "recipes").is_dir()  # recipes came in the wheel


def shell_line(recipe: str, *arguments: str) -> str:
    """What to type to start a recipe: in a clone with the Python that runs now."""
    if INSTALLED:
        return " ".join(["zfall", recipe, *arguments])
    return " ".join([shown_path(Path(sys.executable)), "-m", f"recipes.{recipe}", *arguments])


def shown_path(path: Path) -> str:
    """A path as short as it can be from here."""
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


def remove_if_empty(folder: Path) -> None:
    """Removes what hydra made before it was known whether anything would be put into it.

    Folders around it go, too, as ``runs/EXPERIMENT`` does, if they are empty and lie below the
    working directory.
    """
    here, folder = Path.cwd(), folder.absolute()
    with suppress(OSError):  # it holds something
        folder.rmdir()
        for around in folder.parents:
            if here not in around.parents:
                break
            around.rmdir()
