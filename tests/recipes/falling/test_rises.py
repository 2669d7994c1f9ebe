"""``recipes.falling.rises`` and ``recipes.falling.lying``, from the shell."""

import re

import pytest
import torch

from tests.shell import run
from zfall.falling.lying import POSTURES, load_lying
from zfall.falling.rises import load_rises
from zfall.robots import ZEROTH01


def test_movements_are_written_as_they_stand_in_the_yaml_and_a_search_varies_one(tmp_path):
    """Of four candidates and one round: only what is searched can change, and no time does."""
    done = run("falling.rises", "searched=[]", f"hydra.run.dir={tmp_path}/written")
    assert done.returncode == 0, done.stderr
    written = load_rises(ZEROTH01, tmp_path / "written" / "rises.npz")
    hip = ZEROTH01.joints.index("right_hip_pitch")
    belly = written.names.index("belly")
    assert written.keyframes[belly, 3, hip].item() == pytest.approx(-1.57)
    small = ["candidates=4", "trials=1", "elite=2", "rounds=1"]
    done = run("falling.rises", "searched=[left]", *small, f"hydra.run.dir={tmp_path}/searched")
    assert done.returncode == 0, done.stderr
    assert "left: " in done.stdout
    before, after = map(float, re.search(r"score (\S+) -> (\S+)", done.stdout).groups())
    found = load_rises(ZEROTH01, tmp_path / "searched" / "rises.npz")
    others = [i for i, name in enumerate(found.names) if name != "left"]
    assert torch.equal(found.keyframes[others], written.keyframes[others])
    assert torch.equal(found.ends, written.ends)
    changed = not torch.equal(found.keyframes, written.keyframes)
    assert changed == (after > before) or after == before  # as printed, to two digits


def test_a_movement_that_there_is_not_is_refused(tmp_path):
    done = run("falling.rises", "searched=[fly]", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    assert "searched must be of belly, back" in done.stderr
    assert "got fly" in done.stderr


@pytest.mark.slow
def test_starts_are_recorded_in_every_posture(tmp_path):
    done = run("falling.lying", "count=2", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    bank = load_lying(ZEROTH01, tmp_path / "lying.npz")
    assert torch.bincount(bank["posture"], minlength=len(POSTURES)).tolist() == [2] * 5
