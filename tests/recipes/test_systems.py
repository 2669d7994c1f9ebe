"""Recipes that set the published systems' figures beside ours."""

import numpy as np
import pandas as pd
import pytest

from tests.shell import run

TINY_SWEEP = ["run=pose_hold", "battery.directions=2", "battery.end_time=3.6", "starts=1",
              "impulses=[0.05]", "num_envs=64", "widths=[0,2]"]  # fmt: skip


def test_a_sweep_has_a_row_for_each_width_and_reads_what_is_there(tmp_path):
    done = run("sweep", *TINY_SWEEP, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    rows = pd.read_csv(tmp_path / "sweep.csv")
    assert rows["width"].tolist() == [0, 2]
    assert rows["I = 0.05"].tolist() == [1.0, 1.0]  # a quarter of a newton second moves nobody
    assert rows["pushed"].tolist() == [2, 2]
    trials = [pd.read_csv(tmp_path / f"width_{width}/trials.csv") for width in (0, 2)]
    assert not np.allclose(trials[0]["peak_tilt"], trials[1]["peak_tilt"])
    before = (tmp_path / "width_0/trials.csv").stat().st_mtime_ns
    again = run("sweep", *TINY_SWEEP, f"hydra.run.dir={tmp_path}")
    assert again.returncode == 0, again.stderr
    assert (tmp_path / "width_0/trials.csv").stat().st_mtime_ns == before


def test_a_sweep_of_a_battery_that_draws_nothing_is_refused(tmp_path):
    done = run("sweep", "run=pose_hold", "battery=planar", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    assert "battery.world must be a table that draws something" in done.stderr


def test_curves_are_means_over_runs_with_their_least_and_greatest(tmp_path):
    frames = np.arange(1.0, 401.0)
    for name, slope in (("a", 1.0), ("b", 3.0)):
        table = {"frames": frames, "episode_return": slope * frames, "episode_seconds": slope}
        (tmp_path / name).mkdir()
        pd.DataFrame(table).to_csv(tmp_path / name / "metrics.csv", index=False)
    runs = f"runs={{both: ['{tmp_path}/a', '{tmp_path}/b']}}"
    done = run("systems.curves", runs, f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    rows = pd.read_csv(tmp_path / "out/curves.csv")
    assert len(rows) == 40
    assert rows["episode_seconds"].tolist() == [2.0] * 40
    assert rows["episode_seconds_low"].tolist() == [1.0] * 40
    assert rows["episode_seconds_high"].tolist() == [3.0] * 40
    first = rows.iloc[0]  # frames 1 to 10
    assert (first["frames"], first["episode_return"]) == (5.0, pytest.approx(2 * 5.5))
    assert (tmp_path / "out/episode_return.png").exists()


def test_curves_of_no_run_are_refused(tmp_path):
    done = run("systems.curves", "runs={both: []}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    assert "runs.both must name at least one run" in done.stderr


def test_the_published_pushes_are_printed():
    done = run("systems.pushes")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("| iCub |") == 3
