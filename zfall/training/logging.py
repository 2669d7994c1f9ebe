"""Loggers of a training: TorchRL's, or a class of one's own with the same methods."""

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import imageio.v3 as imageio
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tensorboard.compat.proto.summary_pb2 import Summary
from torchrl.record import TensorboardLogger

from zfall.errors import named
from zfall.training.own_draws import own_draws


class Loggers:
    """Hands every figure of a training to all loggers of its config.

    Nothing that a logger does changes a result: its random numbers are not the training's.

    Args:
        configs: each a table with a ``_target_``. In its texts ``{folder}`` stands for the run
            folder and ``{name}`` for the name of the run.
        folder: the run folder.
        name: of the run; the folder's if ``None``.

    Raises:
        ValueError: on a text with another word in braces, or what gives no logger.
    """

    def __init__(self, configs: Sequence[DictConfig], folder: Path, name: str | None = None):
        words = {"folder": str(folder), "name": name or folder.resolve().name}
        self.loggers: list[Any] = []
        with _own_random_numbers():
            for number, config in enumerate(configs):
                place = f"logger.{number}"
                plain = OmegaConf.to_container(config, resolve=True)
                self.loggers.append(_built(_filled(plain, words, place), place))

    def __bool__(self) -> bool:
        """Whether there are any."""
        return bool(self.loggers)

    def log(self, figures: Mapping[str, float], frames: int) -> None:
        """Writes figures, by name, of the update that ended after so many ``frames``."""
        with _own_random_numbers():
            for logger in self.loggers:
                for name, value in figures.items():
                    logger.log_scalar(name, value, step=frames)

    def log_film(self, path: Path, frames: int) -> list[str]:
        """Hands over a film; returns why a logger did not take it, if one did not."""
        refused = []
        with _own_random_numbers():
            for logger in self.loggers:
                try:
                    _log_film(logger, imageio.imread(path), frames)  # (T, H, W, 3) uint8
                except Exception as error:  # a package that it needs, a format it has not
                    reason = (str(error).splitlines() or [type(error).__name__])[0]
                    refused.append(f"{type(logger).__name__} has no film: {reason}")
        return refused


def _built(config: Mapping[str, Any], place: str) -> Any:
    """A logger, which has at least the method that takes figures."""
    with named(place):
        logger = instantiate(config)
    if not callable(getattr(logger, "log_scalar", None)):
        raise ValueError(
            f"{place}._target_ must make something with a method log_scalar(name, value, step), "
            f"{config['_target_']} makes a {type(logger).__name__}."
        )
    return logger


def _log_film(logger: Any, film: Any, frames: int) -> None:
    if not isinstance(logger, TensorboardLogger):
        video = torch.from_numpy(film).permute(0, 3, 1, 2)[None]  # (1, T, 3, H, W)
        logger.log_video("film", video, step=frames)
        return
    # TensorBoard shows a GIF as a film; torch's own writer of them needs moviepy.
    small = film[::2, ::3, ::3]  # of 25 pictures each second
    coded = imageio.imwrite("<bytes>", small, extension=".gif", duration=80, loop=0)
    height, width = small.shape[1:3]
    image = Summary.Image(height=height, width=width, colorspace=3, encoded_image_string=coded)
    summary = Summary(value=[Summary.Value(tag="film", image=image)])
    logger.experiment._get_file_writer().add_summary(summary, frames)
    logger.experiment.flush()


def _filled(value: Any, words: Mapping[str, str], place: str) -> Any:
    """A config with the words in braces replaced in all of its texts."""
    if isinstance(value, dict):
        return {key: _filled(entry, words, f"{place}.{key}") for key, entry in value.items()}
    if isinstance(value, list):
        return [_filled(entry, words, f"{place}.{i}") for i, entry in enumerate(value)]
    if not isinstance(value, str):
        return value
    try:
        return value.format(**words)
    except (KeyError, IndexError, ValueError, AttributeError, TypeError):
        known = ", ".join(f"{{{word}}}" for word in words)
        raise ValueError(
            f"{place} must have no words in braces but {known}, got {value}."
        ) from None


@contextmanager
def quiet_threads() -> Iterator[None]:
    """Lets threads of loggers fail at a file without a traceback: they raise it in the next call.

    TensorBoard's does.
    """
    previous = threading.excepthook

    def hook(failed: threading.ExceptHookArgs) -> None:
        if not issubclass(failed.exc_type, OSError):
            previous(failed)

    threading.excepthook = hook
    try:
        yield
    finally:
        threading.excepthook = previous


@contextmanager
def _own_random_numbers() -> Iterator[None]:
    with own_draws():
        yield
