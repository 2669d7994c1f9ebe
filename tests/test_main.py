"""The command ``zfall``, and what an installed package brings."""

import subprocess
import sys
import zipfile

import pytest

from tests.shell import ROOT
from zfall.configs import config_folder, options_of


def zfall(*args: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "zfall", *args]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)


def test_without_a_recipe_all_are_listed():
    done = zfall()
    assert done.returncode == 0
    listed = {line.split()[0] for line in done.stdout.splitlines()[2:]}
    scripts = {path.stem for path in config_folder().glob("*.py")} - {"__init__", "shell"}
    assert scripts | {"falling.trigger", "falling.switch"} <= listed


def test_a_misspelt_recipe_is_one_line_that_names_the_nearest():
    done = zfall("trian")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert "did you mean train?" in done.stderr


def test_a_recipe_gets_its_arguments():
    done = zfall("train", "seed=-1")
    assert done.returncode == 1
    assert done.stderr.startswith("error: seed must")


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> list[str]:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", str(ROOT), "--no-deps", "--quiet", "-w"]
    subprocess.run([*build, str(folder)], check=True, capture_output=True)
    (path,) = folder.glob("*.whl")
    return zipfile.ZipFile(path).namelist()


def test_the_wheel_has_one_top_level_package_with_the_yaml_in_it(wheel):
    assert {name.split("/")[0] for name in wheel if ".dist-info" not in name} == {"zfall"}
    inside = set(wheel)
    assert "zfall/py.typed" in inside
    for group in ("env", "experiment", "battery", "study"):
        for name in options_of(group):
            assert f"zfall/recipes/{group}/{name}.yaml" in inside
    for path in (ROOT / "zfall").rglob("*.py"):
        assert str(path.relative_to(ROOT)) in inside
    for path in (ROOT / "zfall" / "policies").glob("*.pt"):
        assert str(path.relative_to(ROOT)) in inside
