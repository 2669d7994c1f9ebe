"""Sweeps and searches on a cluster, also of nodes with disks of their own."""

import threading

import numpy as np
import pytest

from tests.cluster.conftest import kill_a_worker, rows, wait_until
from tests.shell import TINY, run
from zfall.falling.files import own_file
from zfall.falling.movements import load_catches
from zfall.robots import ZEROTH01

LONG = [*TINY, "total_frames=1600", "epochs=1"]


@pytest.mark.slow
def test_trainings_whose_worker_dies_go_on_elsewhere_from_files_that_were_fetched(
    cluster, tmp_path, monkeypatch
):
    """The nodes see no file of ours; a job that is wrong is named, and the others end well."""
    monkeypatch.chdir(tmp_path)
    for seed in (0, 1):
        assert run("train", *LONG, f"seed={seed}", f"hydra.run.dir=alone/{seed}").returncode == 0
    launcher = ["hydra/launcher=ray", f"hydra.launcher.address='{cluster}'"]
    launcher += ["hydra.launcher.shared=false", "hydra.launcher.every=0.2"]
    killer = threading.Thread(
        target=lambda: (wait_until(lambda: rows(tmp_path / "sweep") >= 4), kill_a_worker()),
        daemon=True,
    )
    killer.start()
    done = run("train", "-m", *LONG, "seed=0,1", "hydra.sweep.dir=sweep", *launcher)
    killer.join()
    assert done.returncode == 0, done.stderr
    for seed in (0, 1):
        for name in ("metrics.csv", ".hydra/config.yaml"):
            alone = (tmp_path / "alone" / str(seed) / name).read_text()
            assert (tmp_path / "sweep" / str(seed) / name).read_text() == alone
        assert "50/50" in (tmp_path / "sweep" / f"{seed}.log").read_text()
    again = run("train", "-m", *LONG, "seed=0,3", "hydra.sweep.dir=sweep", *launcher)
    assert again.returncode == 1  # the second of the folder has another seed
    assert "1 of 2 failed; #1 " in again.stderr.splitlines()[-1]
    assert "with which resume=auto goes on" in again.stderr


@pytest.mark.slow
def test_a_search_on_a_cluster_finds_what_it_finds_alone(cluster, tmp_path):
    bank = own_file(ZEROTH01, "falls.npz")
    small = [f"falls={bank}", "candidates=4", "trials=1", "elite=2", "rounds=1", "headings=[0,90]"]
    assert run("falling.catches", *small, f"hydra.run.dir={tmp_path}/alone").returncode == 0
    where = ["launcher=ray", f"launch={{address: '{cluster}'}}", f"hydra.run.dir={tmp_path}/apart"]
    done = run("falling.catches", *small, *where)
    assert done.returncode == 0, done.stderr
    found = [load_catches(ZEROTH01, tmp_path / name / "catches.npz") for name in ("alone", "apart")]
    np.testing.assert_array_equal(*(each.postures.numpy() for each in found))
    text = [(tmp_path / name / "outcomes.txt").read_text() for name in ("alone", "apart")]
    assert text[0] == text[1]
