"""Who may import whom."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.shell import ROOT


def lint(folder: Path) -> subprocess.CompletedProcess:
    code = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports())"
    env = {"PYTHONPATH": str(folder), "PATH": ""}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("file", "upwards", "broken"),
    [
        ("zfall/errors.py", "zfall.training.learner", "Imports point downwards BROKEN"),
        ("zfall/evaluation/battery.py", "zfall.training", "Imports point downwards BROKEN"),
        ("zfall/evaluation/battery.py", "zfall.falling.modes", "Imports point downwards BROKEN"),
        ("zfall/losses/caps.py", "zfall.simulation", "Networks and losses know no simulation BRO"),
        ("zfall/falling/modes/machine.py", "recipes.train", "Imports point downwards BROKEN"),
    ],
)
def test_an_import_that_points_upwards_is_found(tmp_path, file, upwards, broken):
    ignore = shutil.ignore_patterns("__pycache__", "assets", "*.pt")
    for name in ("zfall", "recipes"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    path = tmp_path / file
    path.write_text(f"{path.read_text()}\nimport {upwards}\n")
    done = lint(tmp_path)
    assert done.returncode == 1
    assert broken in done.stdout
