"""The recipe of the reference motions: what it writes."""

import numpy as np

from recipes import gaits
from zfall.motions import library
from zfall.motions.library import gaits_of, motions_file
from zfall.robots import ZEROTH01


def test_the_recipe_writes_the_shipped_motions_and_a_table(tmp_path, monkeypatch, capsys):
    path = tmp_path / "motions.npz"
    monkeypatch.setattr(library, "motions_file", lambda robot: path)
    few = dict(list(gaits_of(ZEROTH01).items())[:2])
    monkeypatch.setattr(library, "gaits_of", lambda robot: few)
    gaits.main(seconds=0.04)
    with np.load(path) as written, np.load(motions_file(ZEROTH01)) as shipped:
        assert written.files == shipped.files
        rows = written["count"].sum()
        for key in ("joint_position", "base_linear_velocity"):
            np.testing.assert_allclose(written[key], shipped[key][:rows], atol=2e-6)
    table = capsys.readouterr().out
    assert all(name in table for name in few)
