"""``zfall train ...``: the recipes as one command, with the yaml that they have in a clone."""

import ast
import runpy
import sys
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path

from zfall.configs import config_folder

HELPERS = ("__init__", "shell")  # of the recipes, and none themselves


def main() -> None:
    """Starts the recipe that the first argument names; without one lists them all.

    Raises:
        SystemExit: with one line on a name that is no recipe.
    """
    recipes = _recipes()
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        width = max(map(len, recipes))
        print("zfall RECIPE [KEY=VALUE ...]     zfall RECIPE --help shows its keys\n")
        print("\n".join(f"  {name:<{width}}  {about}" for name, about in recipes.items()))
        return
    if sys.argv[1] == "--version":
        print(f"zfall {sys.modules['zfall'].__version__}")
        return
    name = sys.argv.pop(1)
    if name not in recipes:
        near = get_close_matches(name, recipes, n=1)
        hint = f"; did you mean {near[0]}?" if near else "."
        raise SystemExit(f"error: recipe must be one of {', '.join(recipes)}, got {name}{hint}")
    # An installed zfall holds the recipes; a clone has them next to it, whatever is installed.
    found = find_spec("zfall.recipes")
    ours = found is not None and found.origin == str(config_folder() / "__init__.py")
    package = "zfall.recipes" if ours else "recipes"
    sys.argv[0] = f"zfall {name}"
    runpy.run_module(f"{package}.{name}", run_name="__main__", alter_sys=True)


def _recipes() -> dict[str, str]:
    """Name and purpose of each recipe; those of falling are ``falling.NAME``."""
    folder = config_folder()
    scripts = [path for path in folder.rglob("*.py") if path.stem not in HELPERS]
    names = {".".join(path.relative_to(folder).with_suffix("").parts): path for path in scripts}
    order = sorted(names, key=lambda name: (name.count("."), name))
    return {name: _first_line(names[name]) for name in order}


def _first_line(script: Path) -> str:
    about = ast.get_docstring(ast.parse(script.read_text())) or ""
    return about.split("\n", 1)[0].split(": ``")[0].rstrip(".")


if __name__ == "__main__":
    main()
