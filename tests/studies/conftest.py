"""A tiny study of pushes, and one of falls."""

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from zfall.studies import Study
from zfall.studies.plan import Test
from zfall.studies.store import Store

SWITCHED = "zfall.falling.switched_with.SwitchedWith"
TINY = {
    "name": "tiny",
    "base": ["experiment=quickstart_studied", "num_envs=16", "rollout_steps=4", "epochs=2",
             "checkpoint_every=1"],
    "rows": {"none": [], "mirrored": ["symmetry=augmentation"]},
    "seeds": [0, 1],
    "total_frames": 256,
    "battery": {
        "name": "planar", "starts": 1, "impulses": [0.1, 0.4], "directions": 2, "end_time": 3.4
    },
    "training_size": "0.4",
}  # fmt: skip
FALLS = {
    "name": "falls",
    "base": ["experiment=quickstart_studied", "num_envs=16", "rollout_steps=4", "epochs=2"],
    "rows": {
        "two": ["experiment=push_to_kneel_kneel"],
        "one": ["experiment=push_to_kneel"],
        "script": ["experiment=push_to_kneel_recover"],
    },
    "tested_with": {
        "two": {
            "_target_": SWITCHED,
            "recover": ["experiment=push_to_kneel_recover", "num_envs=16", "rollout_steps=4",
                        "epochs=2"],
        },
        "script": {"_target_": SWITCHED, "kneel": "script"},
    },
    "tests": {
        "tilt": ["experiment=push_to_kneel"],
        "late": ["experiment=push_to_kneel", "env.transforms.mode.angle=1.2"],
    },
    "seeds": [0],
    "total_frames": 64,
    "battery": {
        "name": "kneel", "starts": 1, "force_starts": 1, "impulses": [1.5], "directions": 1,
        "forces": [[20, 0]], "end_time": 1.5,
    },
}  # fmt: skip


CURVE = {"frames": [1.0, 2.0], "episode_return": [float("nan"), 0.5], "episode_seconds": [1.0, 2.0]}


def some_test(**config: Any) -> Test:
    """A test of a training by this config, which nothing has to run."""
    inputs = {"training": {"config": config, "contents": {}}, "battery": {"name": "planar"}}
    return Test("", None, inputs)


def write(store: Store, test: Test, study: str = "tiny", **figures: float) -> None:
    """Stores a result of a test."""
    who = {"study": study, "row": "none", "seed": 0}
    store.write(test, who, figures or {"success": 0.5}, pd.DataFrame(CURVE))


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of every text that is written, ten characters have room."""
    write_text = Path.write_text

    def full(self: Path, text: str, *args: Any, **kwargs: Any) -> None:
        write_text(self, text[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)


@pytest.fixture
def tiny() -> Callable[..., Study]:
    """The study of pushes, with some of its values replaced."""

    def build(**changes: Any) -> Study:
        return Study(**(TINY | changes))

    return build


@pytest.fixture
def falls() -> Callable[..., Study]:
    """The study of falls, with some of its values replaced."""

    def build(**changes: Any) -> Study:
        return Study(**(FALLS | changes))

    return build
