"""Paths that yaml files and checkpoints of earlier versions name."""

import pytest
from hydra.utils import get_object

from tests.shell import run
from zfall.moved import MOVED, moved, with_new_paths


@pytest.mark.parametrize("old", MOVED)
def test_every_new_path_leads_somewhere(old):
    new = moved(old)
    try:
        get_object(new)
    except ImportError:  # a package, which hydra does not count
        __import__(new)


def test_the_longest_path_that_fits_counts():
    kneel = "zfall.envs.transforms.actions.KneelReference"
    assert moved(kneel) == "zfall.falling.kneel_reference.KneelReference"
    assert moved("zfall.envs.transforms.actions.ActuatorDelay") is None


def test_a_text_keeps_all_but_the_paths():
    text = "a: {_target_: zfall.envs.model.Ball, mass: 0.2}  # zfall.envs.modelling"
    assert with_new_paths(text) == text.replace("zfall.envs.model.Ball", "zfall.robots.Ball")


def test_an_old_path_from_the_shell_is_answered_with_the_new_one(tmp_path):
    old = "zfall.envs.transforms.modes.ModeMachine"
    done = run("train", f"+env.transforms.mode={{_target_: {old}}}", f"hydra.run.dir={tmp_path}/a")
    assert done.returncode == 1
    assert old in done.stderr
    assert "moved to zfall.falling.modes.ModeMachine" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
