"""The bar of a study."""

from typing import ClassVar

import pytest
from rich.progress import Progress

from tests.studies.conftest import some_test, write
from zfall.studies import plan
from zfall.studies.launch import follow, frames_done
from zfall.studies.store import Store


def test_the_bar_follows_files_and_reads_no_config(tmp_path):
    """One run is finished, its folder gone; one has trained 1.2 million of 2; configs are none."""
    runs = [plan.Run("row", seed, None, None, (), (some_test(seed=seed),)) for seed in (0, 1)]
    store = Store(tmp_path / "results", tmp_path)
    write(store, runs[0].tests[0])
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "metrics.csv").write_text("update,frames\n1,1200000\n")

    class Twice:
        waits: ClassVar = [False, True]

        def wait(self, seconds: float) -> bool:
            return self.waits.pop(0)

    frames = {tmp_path / "a": 1_000_000, tmp_path / "b": 2_000_000}
    with Progress(disable=True) as bar:
        follow(bar, "tiny", runs, [[folder] for folder in frames], frames, store, Twice())
        (task,) = bar.tasks
    assert (task.completed, task.total, task.description) == (2.2, 3.0, "study tiny")


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("update,frames\n1,64\n2,128\n", 128),
        ("update,frames\n1,64\n2,12", 64),  # of 128, which is being written
        ("update,frames\n1,64\n2", 64),
        ("update,frames\n1,64\n2,\x00\n", 64),
        ("update,frames\n1,999\n", 200),
        ("update,fra", 0),
        ("", 0),
        (None, 0),
    ],
)
def test_only_whole_rows_are_counted(tmp_path, text, frames):
    if text is not None:
        (tmp_path / "metrics.csv").write_text(text)
    assert frames_done(200, tmp_path) == frames
