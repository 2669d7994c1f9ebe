"""Trainings of studies: what was begun goes on, if this version began it."""

import pytest

from zfall import checkpoint
from zfall.studies import execute
from zfall.training.run_folder import VERSION


@pytest.mark.parametrize(("version", "kept"), [(VERSION, True), (VERSION - 1, False)])
def test_what_another_version_began_begins_anew(
    monkeypatch, compose_config, tmp_path, version, kept
):
    """Else it would be refused for good, and the row never finished."""
    folder = tmp_path / "run"
    (folder / "checkpoints").mkdir(parents=True)
    checkpoint.save(folder / "checkpoints" / "last.pt", {"run": {"version": version}})
    (folder / "metrics.csv").write_text("update,falls\n1,3\n")
    found = []

    def training(cfg, folder, console) -> bool:
        found.append((folder / "metrics.csv").exists())
        return True

    monkeypatch.setattr(execute, "run_training", training)
    execute.train(compose_config(), folder)
    assert found == [kept]


def test_a_training_that_ctrl_c_ends_ends_the_study(monkeypatch, compose_config, tmp_path):
    monkeypatch.setattr(execute, "run_training", lambda cfg, folder, console: False)
    with pytest.raises(SystemExit, match="130"):
        execute.train(compose_config(), tmp_path / "run")
