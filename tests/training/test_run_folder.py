"""What a run writes down."""

import pandas as pd
import pytest
from omegaconf import OmegaConf

from tests.shell import TINY, run
from zfall.training.run_folder import RunFolder


def test_rows_of_metrics_keep_their_columns_when_no_episode_ends(tmp_path):
    """The first batch of 4 steps ends no episode, later ones do."""
    more = ["total_frames=256", "env.transforms.limit.seconds=0.2", f"hydra.run.dir={tmp_path}"]
    done = run("train", *TINY, *more)
    assert done.returncode == 0, done.stderr
    metrics = pd.read_csv(tmp_path / "metrics.csv")
    assert metrics["episodes"].iloc[0] == 0 < metrics["episodes"].max()
    assert metrics["episode_return"].isna().iloc[0]
    ended = metrics[metrics["episodes"] > 0]
    assert (ended["episode_seconds"] - 0.2).abs().max() < 1e-6
    assert (metrics["reward/survival"] - 0.1).abs().max() < 1e-6
    assert (metrics["kl"] >= 0).all()


@pytest.mark.parametrize(
    "recipe", ["evaluate", "play", "export", "falling.trigger", "falling.falls"]
)
def test_a_recipe_that_is_refused_leaves_no_folder(recipe, tmp_path):
    done = run(recipe, "run=nowhere", f"hydra.run.dir={tmp_path}/new")
    assert done.returncode == 1
    assert "there is no folder nowhere" in done.stderr
    assert not (tmp_path / "new").exists()


def test_the_best_checkpoint_is_the_hardest_level_then_the_highest_return(tmp_path):
    """Told updates with a return and a level, a save after each; later ones while there are few."""
    saved = []
    folder = RunFolder(tmp_path, OmegaConf.create({"logger": []}))
    folder.save = lambda learner, name: saved.append((learner, name))
    returns = [*[9.0] * 9, *[1.0] * 10, *[2.0] * 10, *[1.5] * 20]
    for number, value in enumerate(returns):
        level = 0.5 if number >= 39 else 0.0
        folder.note({"episode_return": value, "curriculum/level": level})
        folder.save_last_and_best(number)
    best = [number for number, name in saved if name == "best"]
    assert best[:10] == list(range(10))  # nine with 9 and one with 1: not to be beaten below
    assert set(best[10:]) == set(range(39, 49))  # until the level counts
    assert [name for number, name in saved if number == 5] == ["best", "last"]


def test_a_refused_logger_leaves_nothing_that_looks_like_a_run(tmp_path):
    logger = {"_target_": "torchrl.record.CSVLogger", "exp_name": "{nme}"}
    with pytest.raises(ValueError, match=r"logger.0.exp_name .*got \{nme\}"):
        RunFolder(tmp_path / "run", OmegaConf.create({"logger": [logger]}))
    assert not (tmp_path / "run" / "checkpoints").exists()
