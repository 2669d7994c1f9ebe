"""The search for movements, from the shell."""

import re

from tests.shell import run
from zfall.falling.files import own_file
from zfall.falling.movements import load_catches
from zfall.robots import ZEROTH01

BANK = own_file(ZEROTH01, "falls.npz")


def test_recipe_writes_a_file_that_can_be_loaded(tmp_path):
    small = ["headings=[0,330]", "candidates=4", "trials=1", "elite=2", "rounds=1"]
    small += [f"hydra.run.dir={tmp_path}"]
    done = run("falling.catches", f"falls={BANK}", *small)
    assert done.returncode == 0, done.stderr
    assert "330 degrees, from 1.65 m/s: " in done.stdout
    found = load_catches(ZEROTH01, tmp_path / "catches.npz")
    assert found.postures.shape == (12, 4, 5, 20)
    kept = (found.postures == load_catches(ZEROTH01).postures).all(-1).all(-1)
    assert kept[1:-1].all()  # of the other headings
    assert kept[[0, -1]].float().mean() > 0.5  # one round of four candidates seldom beats it
    for value in ("[45]", "[]", "[a,30]"):
        bad = run("falling.catches", f"falls={BANK}", f"headings={value}")
        assert bad.returncode == 1
        assert re.match(r"error: headings.* must .*got ", bad.stderr)
    bad = run("falling.catches", f"falls={tmp_path}/none.npz")
    assert bad.returncode == 1
    assert re.match("error: falls must be a file .*none.npz", bad.stderr)
