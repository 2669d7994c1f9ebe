"""All that a result of a study follows from, as it is stored, and what that means."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

from omegaconf import DictConfig, OmegaConf

from zfall.envs.tables import contents_of
from zfall.fingerprints import digest, file_digest
from zfall.meaning import meaning, strict
from zfall.policies.load import checkpoint_of

Inputs = Mapping[str, Any]  # JSON values
_POLICIES = ("warm_start", "teacher")  # keys that must name a policy


def training_inputs(cfg: DictConfig) -> dict[str, Any]:
    """The config of a training, and digests of the files and policies that it names.

    Any text outside of the env that names a run folder, or a policy that ships, counts by the
    policy's weights, whatever its key.

    Raises:
        ValueError: if it has stages, or ``warm_start`` or a ``teacher`` names no policy.
    """
    if cfg.get("stages"):
        raise ValueError("stages must be {} in a study: give each row the warm_start of a run.")
    config = OmegaConf.to_container(cfg, resolve=True)
    assert isinstance(config, dict)
    contents = contents_of({str(key): value for key, value in config.items()})
    for key, value in _texts({key: each for key, each in config.items() if key != "env"}):
        try:
            path = checkpoint_of(value, key=key)
        except (ValueError, OSError):
            if key.rpartition(".")[2] in _POLICIES:
                raise
            continue
        with suppress(OSError):  # a run without its last checkpoint: whoever reads it says so
            contents[key] = file_digest(path)
    return {"config": strict(config), "contents": contents}


def world_inputs(env_cfg: DictConfig) -> dict[str, Any]:
    """The config of a test's env, and digests of the files that it names."""
    config = {"env": OmegaConf.to_container(env_cfg, resolve=True)}
    return {"config": strict(config), "contents": contents_of(config)}


def meaning_of(inputs: Inputs) -> dict[str, str]:
    """What tells a result from all others, whatever study it belongs to.

    Args:
        inputs: ``training`` and, if there are others that are trained, ``others``, as
            ``training_inputs`` gives them; ``world`` as ``world_inputs`` does; ``battery``, its
            fields; and what is compared as it is.
    """
    parts = {key: meaning(**inputs[key]) for key in ("training", "world") if key in inputs}
    others = [meaning(**other) for other in inputs.get("others", ())]
    return combined({**inputs, **parts, "others": others})


def combined(inputs: Inputs) -> dict[str, str]:
    """The same of inputs whose configs have been replaced by their meanings."""
    rest = dict(inputs)
    found, battery = dict(rest.pop("training")), rest.pop("battery")
    parts = {f"others.{number}": other for number, other in enumerate(rest.pop("others", ()))}
    parts["world"] = rest.pop("world", {})
    for name, part in parts.items():
        found |= {f"{name}.{key}": value for key, value in part.items()}
    return found | meaning({"test": rest, "battery": {battery["name"]: battery}})


def training_digest(cfg: DictConfig) -> str:
    """Tells a training from all others."""
    return digest(meaning(**training_inputs(cfg)))


def _texts(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Texts of a config by their full keys."""
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, Mapping | list):
        entries = value.items() if isinstance(value, Mapping) else enumerate(value)
        for name, each in entries:
            yield from _texts(each, f"{key}.{name}".lstrip("."))
