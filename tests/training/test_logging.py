"""Loggers by their path in the config."""

import pytest
import torch
from omegaconf import OmegaConf
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from zfall.training.logging import Loggers
from zfall.training.loop import run_training

SIZES = ("num_envs=8", "rollout_steps=4", "minibatches=2", "total_frames=64", "showcase=null")


class Greedy:
    """Keeps what it gets in a list, and draws random numbers all the time."""

    kept: list = []

    def __init__(self, title):
        self.title = title
        torch.manual_seed(1)

    def log_scalar(self, name, value, step):
        torch.rand(3)
        self.kept.append((self.title, name, value, step))

    def log_video(self, name, video, step):
        raise ModuleNotFoundError("No module named 'a_codec'")


def test_a_logger_changes_no_result_and_gets_every_figure(compose_config, tmp_path):
    own = "logger=[{_target_: tests.training.test_logging.Greedy, title: 'of {name}'}]"
    Greedy.kept.clear()
    for name, logger in (("none", "logger=[]"), ("own", own)):
        run_training(
            compose_config(*SIZES, logger, "name=first"), tmp_path / name, Console(quiet=True)
        )
    texts = [(tmp_path / name / "metrics.csv").read_text() for name in ("none", "own")]
    assert texts[0] == texts[1]
    columns = texts[0].splitlines()[0].split(",")
    names = [name for title, name, _, step in Greedy.kept if step == 64 and title == "of first"]
    assert set(names) == {*columns, "frames_per_s", "policy/std", "policy/entropy"}


def test_tensorboard_is_there_by_default_and_shows_how_much_the_policy_explores(
    compose_config, tmp_path
):
    """Of a Gaussian of 0.3 the entropy of 20 joints is 20 (0.5 log(2 pi e) + log 0.3) = 4.30."""
    run_training(
        compose_config(*SIZES, "actor.std=0.3", "optimizer.lr=1e-5"), tmp_path, Console(quiet=True)
    )
    board = EventAccumulator(str(tmp_path / "tensorboard"))
    board.Reload()
    assert board.Scalars("policy/std")[-1].value == pytest.approx(0.3, abs=1e-3)
    assert board.Scalars("policy/entropy")[-1].value == pytest.approx(4.30, abs=0.02)
    assert board.Scalars("learning_rate")[-1].value > 0


def test_an_unknown_word_in_braces_is_refused(tmp_path):
    config = {"_target_": "tests.training.test_logging.Greedy", "title": "{run}"}
    with pytest.raises(ValueError, match=r"logger.0.title .*\{folder\}, \{name\}, got \{run\}"):
        Loggers([OmegaConf.create(config)], tmp_path)


def test_a_film_goes_to_tensorboard_and_a_logger_that_cannot_says_why(tmp_path):
    import imageio.v3 as imageio
    import numpy as np

    film = np.zeros((5, 32, 48, 3), np.uint8)
    film[:, 8:16] = np.arange(5)[:, None, None, None] * 50
    imageio.imwrite(tmp_path / "film.mp4", film, fps=10)
    configs = [
        {"_target_": "torchrl.record.TensorboardLogger", "exp_name": "tb", "log_dir": "{folder}"},
        {"_target_": "tests.training.test_logging.Greedy", "title": "x"},
    ]
    loggers = Loggers([OmegaConf.create(config) for config in configs], tmp_path)
    refused = loggers.log_film(tmp_path / "film.mp4", 64)
    assert len(refused) == 1
    assert "a_codec" in refused[0]
    board = EventAccumulator(str(tmp_path / "tb"))
    board.Reload()
    (image,) = board.Images("film")
    assert (image.height, image.width) == (11, 16)
    assert image.encoded_image_string.startswith(b"GIF8")


@pytest.mark.parametrize(
    "target", ["torchrl.record.CSVLogger", "builtins.print", "builtins.nothing", "zfall.nothing"]
)
def test_what_gives_no_logger_is_refused_with_its_key(target, tmp_path):
    with pytest.raises(ValueError, match=r"logger\.0"):
        Loggers([OmegaConf.create({"_target_": target})], tmp_path)
