"""Checkpoints: written whole or not at all, read without executing code, refused if damaged."""

import hashlib
import io
import os
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from torch import Tensor

from zfall.errors import in_one_line, why_unfit
from zfall.trust import config_of_file

FORMAT = 7  # raise it when policies written before can no longer be read

Kinds = Mapping[str, type]
_KINDS = {Mapping: "table", str: "text", int: "whole number", list: "list", Tensor: "tensor"}
# What must be there, by what it is read for.
POLICY: Kinds = {"config": str, "robot": str, "actor": Mapping, "policy": Mapping}
TRAINING: Kinds = {
    **POLICY,
    **{"critic": Mapping, "optimizer": Mapping, "scheduler": Mapping, "buffers": Mapping},
    **{"worlds": list, "run": Mapping, "rng": Tensor},
    **{"averaged": int, "frames": int, "updates": int},
}


def save(path: Path, content: dict[str, Any]) -> None:
    """Writes tensors, numbers, text and containers of them to ``path``, with their digest.

    The file is written under a temporary name and then renamed, so that a crash or a full disk
    leaves the old one.

    Raises:
        OSError: if it cannot be written; what was there before is still there.
        ValueError: if a weight is NaN or infinite, as ``load`` refuses it.
    """
    buffer = io.BytesIO()
    content = {key: value for key, value in content.items() if key not in _ABOUT}
    _check_weights(content, path, "what was there before is untouched.")
    torch.save({"format": FORMAT, **content, "digest": content_digest(content)}, buffer)
    temporary = path.with_suffix(".tmp")
    try:
        temporary.unlink(missing_ok=True)
        with temporary.open("xb") as file:  # anew: not through a link
            file.write(buffer.getbuffer())
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        why = f"{error.strerror or error}; what was there before is untouched."
        raise OSError(f"{path} must be writable: {why}") from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Makes the new name last, too, should the machine stop now."""
    with suppress(OSError):  # not every file system can
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def load(path: Path, kinds: Kinds = POLICY) -> dict[str, Any]:
    """Reads what ``save`` wrote; of its ``config``, yaml, nothing that is built can do harm.

    Args:
        path: of the file.
        kinds: the keys that must be there, and what they hold: ``POLICY``, ``TRAINING``.

    Raises:
        ValueError: if the file does not exist, is no checkpoint, is of another format, lacks a key
            or is damaged, if a weight is NaN or infinite, or if its config names what
            ``zfall.trust`` does not allow.
    """
    content = _read(path)
    for key, kind in kinds.items():
        if key not in content:
            raise ValueError(f"{path} must hold {key}, it lacks it: {_REPAIR}")
        if not isinstance(content[key], kind) or isinstance(content[key], bool):
            got = type(content[key]).__name__
            raise ValueError(f"{path}: {key} must be a {_KINDS[kind]}, got {got}: {_REPAIR}")
    _check_weights(content, path, _REPAIR)
    if "config" in content:  # whoever builds it builds what is checked here
        config = config_of_file(content["config"], path)
        for key in ("env", "actor") if "config" in kinds else ():
            if not isinstance(config.get(key), Mapping):
                raise ValueError(f"{path}: {key} of its config must be a table, there is none.")
        content["config"] = OmegaConf.to_yaml(config)
    return content


def tensors_of(path: Path) -> dict[str, Tensor]:
    """The tensors of a checkpoint by their keys, or only those of its ``policy`` if it has one.

    Raises:
        ValueError: as ``load`` does, but for what its config names.
    """
    content = _read(path)
    return dict(_tensors(content.get("policy", content)))


def _tensors(value: Any, key: str = "") -> Iterator[tuple[str, Tensor]]:
    if isinstance(value, Tensor):
        yield key, value
    elif isinstance(value, Mapping):
        for name, each in value.items():
            yield from _tensors(each, f"{key}.{name}")


def _read(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise ValueError(f"{path} must be a checkpoint, there is no such file.")
    _check_file(path)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
        _check_size(content, path.stat().st_size)
        counted = content_digest({k: v for k, v in content.items() if k not in _ABOUT})
    except Exception as error:  # torch's own message may advise to load it without care
        raise ValueError(f"{path} must be a checkpoint, {_NOT_READ}") from error
    found = content.get("format")
    if type(found) is not int or found != FORMAT:
        shown = found if isinstance(found, int) else type(found).__name__
        raise ValueError(
            f"{path} must be a checkpoint of format {FORMAT}, got {shown}; train it again, or "
            "read it with the version that wrote it."
        )
    if content.pop("digest", counted) != counted:  # not there in files of earlier versions
        raise ValueError(f"{path} must be as it was written, it is damaged: {_REPAIR}")
    return dict(content)


_TIMES = 8  # so much larger than the file its tensors may be; of ours they are smaller
_ABOUT = ("format", "digest")  # not of the content
# What need not be finite: states of envs and of losses, and figures of a run.
_OPEN = ("worlds", "buffers", "run")
_REPAIR = "take another copy, or train it again."
_NOT_READ = f"it is damaged or of another kind: {_REPAIR}"


def _check_weights(content: Mapping[str, Any], path: Path, repair: str) -> None:
    """Refuses networks and optimizers with NaN or infinite values."""
    learned = {key: value for key, value in content.items() if key not in _OPEN}
    for key, value in _tensors(learned):
        if value.is_floating_point() and not (finite := value.isfinite()).all():
            worst = value[~finite][0].item()
            raise ValueError(f"{path}: {key.lstrip('.')} must be finite, got {worst}: {repair}")


def _check_file(path: Path) -> None:
    """Refuses what is no sound zip file of stored entries, as torch writes it."""
    try:
        with zipfile.ZipFile(path) as file:
            stored = all(entry.compress_type == zipfile.ZIP_STORED for entry in file.infolist())
            sound = stored and file.testzip() is None
    except Exception as error:  # a damaged zip file raises almost anything
        raise ValueError(f"{path} must be a checkpoint, {_NOT_READ}") from error
    if not sound:
        raise ValueError(f"{path} must be a checkpoint, {_NOT_READ}")


def _check_size(content: Any, size: int) -> None:
    """Refuses a small file whose content is large: tensors and lists that repeat themselves."""
    parts, in_tensors, stack = 0, 0, [content]
    while stack:
        value = stack.pop()
        parts += 1
        if isinstance(value, Tensor):
            in_tensors += value.numel() * value.element_size()
        elif isinstance(value, Mapping):
            stack += [*value.keys(), *value.values()]
        elif isinstance(value, (list, tuple)):
            stack += value
        if parts > size or in_tensors > _TIMES * size:  # each part takes a byte or more
            raise ValueError("it stands for more than it holds")


def content_digest(content: Any) -> str:
    """Tells the content of a checkpoint from all others, every bit of it."""
    total = hashlib.sha256()
    _digest_into(total.update, content)
    return total.hexdigest()


def _digest_into(add: Callable[[Any], None], value: Any) -> None:
    if isinstance(value, Tensor):
        plain = value.detach().cpu().contiguous()
        add(f"tensor {plain.dtype} {tuple(plain.shape)};".encode())
        add(plain.reshape(-1).view(torch.uint8).numpy())
    elif isinstance(value, Mapping):
        add(f"table {len(value)};".encode())
        for key, entry in value.items():
            _digest_into(add, key)
            _digest_into(add, entry)
    elif isinstance(value, (list, tuple)):
        add(f"{type(value).__name__} {len(value)};".encode())
        for entry in value:
            _digest_into(add, entry)
    else:
        text = repr(value).encode(errors="surrogatepass")
        add(f"{type(value).__name__} {len(text)};".encode() + text)


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Within it what is read out of a checkpoint is used: errors say that it does not fit.

    Raises:
        ValueError: naming the file and the reason.
    """
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:  # which name the key
        raise ValueError(f"{path}: {in_one_line(error)}") from error
    except (KeyError, TypeError, AttributeError, IndexError, RuntimeError) as error:
        raise ValueError(f"{path} must fit what reads it: {why_unfit(error)}") from error


def check_fits(content: dict[str, Any], robot: str, actor: torch.nn.Module, path: Path) -> None:
    """Refuses a checkpoint whose robot or actor is another.

    Raises:
        ValueError: naming what differs.
    """
    if content["robot"] != robot:
        raise ValueError(f"{path} must be of the robot {robot}, it is of {content['robot']}.")
    mine = {key: tuple(value.shape) for key, value in actor.state_dict().items()}
    theirs = {key: tuple(value.shape) for key, value in content["actor"].items()}
    if mine != theirs:
        differing = sorted(k for k in mine.keys() | theirs.keys() if mine.get(k) != theirs.get(k))
        key = differing[0]
        raise ValueError(
            f"{path} must hold the configured actor, but {key} has shape {theirs.get(key)} there "
            f"and {mine.get(key)} here; give the actor and env it was trained with."
        )
