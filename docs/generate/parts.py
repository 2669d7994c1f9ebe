"""What a yaml table can name: transforms, terms, networks and losses, found in the package itself.

A new class appears on its page by being there; nothing lists it by hand.
"""

import inspect
import pkgutil
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml
from torchrl.envs import Transform
from torchrl.objectives import LossModule
from torchrl.objectives.value import ValueEstimatorBase

ROOT = Path(__file__).parents[2]
RECIPES = ROOT / "recipes"
REFERENCE = ROOT / "docs" / "reference"
FILLED_IN = ("robot", "joint_range", "env", "td", "next_td", "actor_network", "critic_network")
GROUPS = ("actor", "critic", "loss", "caps", "imitation", "symmetry", "push", "curriculum")
UNNAMED = {"loss": "zfall.losses.ppo.PenalizedPPOLoss"}  # what a group without _target_ makes


@dataclass(frozen=True)
class Part:
    """A class or function that yaml can name.

    Attributes:
        path: what ``_target_`` says.
        made: the class or function.
        line: yaml that makes it; empty for what training takes by itself.
        options: what the shell says to get it, ``actor=mlp_gaussian``.
    """

    path: str
    made: Any
    line: str
    options: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The last part of its path."""
        return self.path.rpartition(".")[2]


def modules(package: str) -> Iterator[ModuleType]:
    """A package and all that lies in it, in alphabetical order; a plain module gives itself."""
    module = import_module(package)
    yield module
    for found in pkgutil.walk_packages(getattr(module, "__path__", []), f"{package}."):
        yield import_module(found.name)


def public_path(made: Any) -> str:
    """The shortest path under which a thing can be imported from its packages."""
    path = made.__module__
    while "." in path:
        above = path.rpartition(".")[0]
        if getattr(import_module(above), made.__name__, None) is not made:
            break
        path = above
    return f"{path}.{made.__name__}"


def defined_in(package: str, wanted: Callable[[Any], bool]) -> list[Any]:
    """Public classes and functions of a package that are wanted, each once."""
    found = {}
    for module in modules(package):
        for name, made in vars(module).items():
            ours = getattr(made, "__module__", None) == module.__name__
            if ours and not name.startswith("_") and wanted(made):
                found[public_path(made)] = made
    return [found[path] for path in sorted(found)]


def is_transform(made: Any) -> bool:
    """A transform, or a function that returns one."""
    if inspect.isfunction(made):
        made = inspect.signature(made).return_annotation
    return inspect.isclass(made) and issubclass(made, Transform)


def is_term(made: Any) -> bool:
    """A function of the TensorDicts before and after a step."""
    return inspect.isfunction(made) and list(inspect.signature(made).parameters)[:2] == [
        "td",
        "next_td",
    ]


def is_loss(made: Any) -> bool:
    """A loss, an estimator of advantages, or what a recipe names next to them."""
    if not inspect.isclass(made):
        return False
    return issubclass(made, (LossModule, ValueEstimatorBase)) or public_path(made) in in_recipes()


def is_network(made: Any) -> bool:
    """A function that builds a network from keys of yaml, as recipes name it."""
    return inspect.isfunction(made) and public_path(made) in in_recipes()


def _targets(node: Any, key: str, weight: Any = None) -> Iterator[tuple[str, str]]:
    """What each mapping with a ``_target_`` makes, and its line of yaml."""
    if isinstance(node, dict):
        if isinstance(node.get("_target_"), str):
            path = node["_target_"]
            if key == "term":  # of a term around it
                key, weight = path.rpartition(".")[2], 1.0
            yield path, flow({key: node if weight is None else [weight, node]})
        for name, child in node.items():
            yield from _targets(child, str(name))
    elif isinstance(node, list):
        for child in node:
            yield from _targets(child, key, node[0] if len(node) == 2 else None)


@cache
def in_recipes() -> dict[str, list[str]]:
    """Lines of yaml in the recipes, by what they make."""
    found: dict[str, list[str]] = {}
    for path in sorted(RECIPES.rglob("*.yaml")):
        for target, line in _targets(yaml.safe_load(path.read_text()), path.parent.name):
            found.setdefault(target, []).append(line)
    return found


@cache
def in_reference() -> dict[str, str]:
    """Lines of yaml that the pages of the reference show, by what they make."""
    lines: dict[str, str] = {}
    for page, package in {
        "transforms.md": "zfall.envs.transforms.",
        "falling.md": "zfall.falling.",
    }.items():
        text = (REFERENCE / page).read_text()
        for line in re.findall(r"`(\w+: \{_target_: \.\.\..*?\})`", text):
            node = yaml.safe_load(line.replace("...", package))
            for target, each in _targets(node, ""):
                lines.setdefault(target, each)
    return lines


@cache
def options() -> dict[str, list[str]]:
    """What the shell says, ``actor=gru_mog``, by what it makes."""
    found: dict[str, list[str]] = {}
    for group in GROUPS:
        for path in sorted((RECIPES / group).glob("*.yaml")):
            for target in _made_by(path, UNNAMED.get(group)):
                found.setdefault(target, []).append(f"{group}={path.stem}")
    return found


def _made_by(path: Path, unnamed: str | None) -> set[str]:
    """What an option makes itself, or the option that it goes on from."""
    node = yaml.safe_load(path.read_text()) or {}
    at_top = [node, *(child for child in node.values() if isinstance(child, dict))]
    named = {each["_target_"] for each in at_top if "_target_" in each}
    if not named:
        for parent in node.get("defaults", []):
            file = path.with_name(f"{parent}.yaml")
            if isinstance(parent, str) and parent != "_self_" and file.exists():
                named |= _made_by(file, None)
    return named or ({unnamed} if unnamed else set())


def flow(node: Any) -> str:
    """Yaml in one line."""
    text = yaml.safe_dump(node, default_flow_style=True, sort_keys=False, width=10**6).strip()
    return text[1:-1]  # without the braces around the key


def from_signature(path: str, made: Any) -> str:
    """Yaml with the parameters that have no default, each as its type in angle brackets."""
    entry: dict[str, Any] = {"_target_": path} | ({"_partial_": True} if is_term(made) else {})
    for name, parameter in inspect.signature(made).parameters.items():
        many = parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL)
        if name not in FILLED_IN and not many and parameter.default is parameter.empty:
            entry[name] = f"<{_plain(parameter.annotation)}>"
    if is_term(made):
        return flow({made.__name__: [1.0, entry]})
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", made.__name__).lower()
    return flow({"loss" if path in UNNAMED.values() else name: entry})


def _plain(annotation: Any) -> str:
    """A type as one reads it: ``float`` of a positive number, ``Tensor`` of torch's."""
    while hasattr(annotation, "__metadata__"):
        annotation = annotation.__origin__
    return re.sub(r"\b(\w+\.)+", "", inspect.formatannotation(annotation))


def part(made: Any) -> Part:
    """A class or function with its line: of the reference, of a recipe, or of its signature."""
    path = public_path(made)
    if inspect.isclass(made) and issubclass(made, ValueEstimatorBase):
        return Part(path, made, "")
    found = in_recipes().get(path, [])
    whole = [line for line in found if "${" not in line] or found
    line = in_reference().get(path) or min(whole, key=len, default=from_signature(path, made))
    return Part(path, made, line, tuple(options().get(path, [])))


def concept(path: str, package: str) -> str:
    """The first module or package below ``package``: ``pushes`` of ``...pushes.RandomPush``."""
    return path.removeprefix(f"{package}.").split(".")[0]


def pages() -> dict[str, str]:
    """The markdown of each generated page, by its path in ``docs``."""
    found: dict[str, list[Any]] = {}
    for kind, package, wanted in (
        ("transforms", "zfall.envs.transforms", is_transform),
        ("terms", "zfall.envs.terms", is_term),
    ):
        for made in defined_in(package, wanted):
            page = f"code/{kind}/{concept(public_path(made), package)}.md"
            found.setdefault(page, []).append(made)
        found[f"code/{kind}/falling.md"] = defined_in("zfall.falling", wanted)
    found["code/actors.md"] = defined_in("zfall.modules.actors", is_network)
    found["code/critics.md"] = defined_in("zfall.modules.critics", is_network)
    found["code/losses.md"] = defined_in("zfall.losses", is_loss)
    return {page: _text(page, [part(each) for each in made]) for page, made in found.items()}


def _text(page: str, parts: list[Part]) -> str:
    """A page in markdown: what lies in it, then each part with its yaml and its docstring."""
    name = Path(page).stem
    text = [f"# {name.capitalize()}"]
    if len({each.made.__module__ for each in parts}) == 1:
        text.append(inspect.getdoc(sys.modules[parts[0].made.__module__]) or "")
    elif len({each.path.rpartition(".")[0] for each in parts}) == 1:
        text.append(inspect.getdoc(sys.modules[parts[0].path.rpartition(".")[0]]) or "")
    for each in parts:
        text.append(f"## {each.name}")
        if each.line:
            text.append(f"```yaml\n{each.line}\n```")
        if each.options:
            text.append("From the shell: " + ", ".join(f"`{name}`" for name in each.options) + ".")
        text.append(f"::: {each.made.__module__}.{each.made.__name__}")
    return "\n\n".join(text) + "\n"
