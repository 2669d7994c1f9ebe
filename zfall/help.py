"""What ``--help`` says of a recipe: its keys from the comments of its yaml, and the groups."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from zfall.commands import shell_line
from zfall.configs import config_folder, options_of

_LINE = re.compile(r"( *)(?:- )?(?:override )?([\w/]+): *(.*?)(?: *(?<=\s)# *(.*))?")
_ELSEWHERE = {"battery", "baseline", "study"}  # groups of other recipes than train
_WIDTH = 28


class Key(NamedTuple):
    """A key of a yaml: its full name, its value as written, and what its comment says."""

    name: str
    value: str
    about: str


def help_of(recipe: str, about: str) -> str:
    """The text for a recipe, ``train`` or ``falling.trigger``.

    Args:
        recipe: its name.
        about: the docstring of its script.
    """
    path = config_folder() / f"{recipe.replace('.', '/')}.yaml"
    lines = [about.strip(), "", shell_line(recipe, "[KEY=VALUE ...]" if path.is_file() else "")]
    if not path.is_file():
        return "\n".join(lines)
    lines += ["", "Keys, with the values that they have without you:"]
    lines += [_row(key.name, key.value, key.about) for key in keys_of(path)]
    if groups := groups_of(path):
        lines += [
            "",
            "Groups: GROUP=NAME takes GROUP/NAME.yaml; +GROUP=NAME one that has no default:",
        ]
        lines += [_row(each.name, each.value, each.about) for each in groups]
    lines += [
        "",
        "KEY.KEY=VALUE changes any value below, +KEY=VALUE adds one, ~KEY takes one out; quotes",
        "keep a list from the shell: 'KEY=[1,2]'. --cfg job shows the whole config.",
    ]
    return "\n".join(lines)


def keys_of(path: Path) -> Iterator[Key]:
    """The keys of a recipe's yaml and those one level below, without hydra's own."""
    for block, lines in _blocks(path):
        if block in ("defaults", "hydra"):
            continue
        above = ""
        for number, line in enumerate(lines):
            if line.startswith("#"):
                above = line.lstrip("# ")
            elif (found := _LINE.fullmatch(line)) and len(found[1]) <= 2 and "- " not in line:
                name = found[2] if number == 0 or not found[1] else f"{block}.{found[2]}"
                yield Key(name, found[3], found[4] or above)
                above = ""


def groups_of(path: Path) -> list[Key]:
    """The groups that a recipe's yaml takes: name, what it takes, and what there is to take."""
    taken = {}
    for block, lines in _blocks(path):
        for line in lines[1:] if block == "defaults" else ():
            found = _LINE.fullmatch(line)
            if found and "/" not in found[2] and "override" not in line:
                taken[found[2]] = found[3]
    if "experiment" in taken:
        folders = sorted(each.name for each in path.parent.iterdir() if each.is_dir())
        more = (name for name in folders if name not in {*taken, *_ELSEWHERE})
        taken |= {
            f"+{name}": "" for name in more if not (path.parent / name / "__init__.py").exists()
        }
    names = {name: options_of(name.lstrip("+")) for name in taken}
    return [Key(name, taken[name], ", ".join(names[name])) for name in taken if names[name]]


def _blocks(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Lines of each top-level key, with its name; full comments above it come first."""
    block: list[str] = []
    name = ""
    for line in path.read_text().splitlines()[1:]:
        begins = re.match(r"(\w+):", line)
        if begins or line.startswith("#"):
            if name:
                yield name, block
                block, name = [], ""
            name = begins[1] if begins else ""
        if line.strip():
            block.append(line)
    if name:
        yield name, block


def _row(name: str, value: str, about: str) -> str:
    given = f"{name}={value}" if value else name
    return f"  {given:<{_WIDTH}}  {about}" if about else f"  {given}"
