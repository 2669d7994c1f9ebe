"""What a recipe says of itself, and that it needs nothing heavy for it."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.shell import ROOT
from zfall.configs import config_folder
from zfall.help import Key, groups_of, help_of, keys_of

HEAVY = ("torch", "torchrl", "tensordict", "mujoco", "pandas", "matplotlib")
RECIPES = sorted(
    ".".join(path.relative_to(ROOT / "recipes").with_suffix("").parts)
    for path in (ROOT / "recipes").rglob("*.py")
    if path.stem not in ("__init__", "shell", "made")  # which the recipes share
)


def light(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Runs Python where what is heavy cannot be imported."""
    (folder / "sitecustomize.py").write_text(
        f"import sys\nsys.modules.update(dict.fromkeys({HEAVY}))\n"
    )
    env = {"PYTHONPATH": f"{folder}:{ROOT}", "PATH": ""}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=env, capture_output=True, text=True, check=False
    )  # fmt: skip


def test_help_comes_without_torch(tmp_path):
    done = light(tmp_path, "-m", "recipes.train", "--help")
    assert done.returncode == 0, done.stderr
    assert "  seed=0                        of all that is random" in done.stdout.splitlines()
    assert light(tmp_path, "-c", "import torch").returncode == 1


def test_a_misspelt_key_is_refused_without_torch(tmp_path):
    done = light(tmp_path, "-m", "recipes.train", "seeed=1")
    assert done.returncode == 1
    assert "did you mean seed?" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_no_recipe_needs_torch_for_its_help(tmp_path):
    code = (
        "import runpy, sys\n"
        f"for recipe in {RECIPES}:\n"
        "    sys.argv = [recipe, '--help']\n"
        "    runpy.run_module(f'recipes.{recipe}', run_name='__main__', alter_sys=True)\n"
    )
    done = light(tmp_path, "-c", code)
    assert done.returncode == 0, done.stderr
    for recipe in RECIPES:
        assert f"python -m recipes.{recipe}" in done.stdout


@pytest.mark.parametrize("recipe", RECIPES)
def test_the_help_of_a_recipe_has_each_key_of_its_yaml(recipe):
    text = help_of(recipe, "Trains a policy.")
    assert text.startswith("Trains a policy.\n")
    path = config_folder() / f"{recipe.replace('.', '/')}.yaml"
    for key in keys_of(path) if path.is_file() else ():
        assert key.name in text


YAML = """\
# python -m recipes.mine
defaults:
  - _self_
  - actor: mlp_gaussian
  - override hydra/job_logging: none

seed: 0            # of all that is random
# Where figures go.
logger:
  - {_target_: mine.Logger}
limits:            # what may be
  low: 1           # the least
  high: 2
    # deeper
    unseen: 3
plain: ""

hydra:
  run: {dir: here}
"""


def test_comments_behind_a_key_or_above_it_are_what_is_said_of_it(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(YAML)
    assert list(keys_of(path)) == [
        Key("seed", "0", "of all that is random"),
        Key("logger", "", "Where figures go."),
        Key("limits", "", "what may be"),
        Key("limits.low", "1", "the least"),
        Key("limits.high", "2", ""),
        Key("plain", '""', ""),
    ]


def test_groups_are_listed_with_what_there_is_to_take(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(YAML)
    (group,) = groups_of(path)
    assert (group.name, group.value) == ("actor", "mlp_gaussian")
    assert {"mlp_gaussian", "gru_mog"} <= set(group.about.split(", "))
