"""Checkpoints: whole, safe, and refused when they do not fit."""

import pickle

import pytest
import torch

from zfall import checkpoint


def test_what_is_saved_is_loaded(tmp_path):
    path = tmp_path / "a.pt"
    checkpoint.save(path, {"weights": {"w": torch.arange(3.0)}, "frames": 7, "config": "seed: 0"})
    content = checkpoint.load(path)
    assert torch.equal(content["weights"]["w"], torch.arange(3.0))
    assert content["frames"] == 7
    assert [p.name for p in tmp_path.iterdir()] == ["a.pt"]


def test_crash_while_writing_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    checkpoint.save(path, {"frames": 1})

    def dies(content: object, target: object) -> None:
        open(target, "wb").write(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", dies)
    with pytest.raises(KeyboardInterrupt):
        checkpoint.save(path, {"frames": 2})
    monkeypatch.undo()
    assert checkpoint.load(path)["frames"] == 1


class Evil:
    def __reduce__(self) -> tuple:
        return (open, ("executed", "w"))


def test_code_in_a_checkpoint_is_not_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"format": checkpoint.FORMAT, "x": Evil()}, tmp_path / "evil.pt")
    with pytest.raises(ValueError, match="cannot read it"):
        checkpoint.load(tmp_path / "evil.pt")
    assert not (tmp_path / "executed").exists()


def test_missing_file_rubbish_and_old_formats_are_refused(tmp_path):
    with pytest.raises(ValueError, match="there is no such file"):
        checkpoint.load(tmp_path / "no.pt")
    (tmp_path / "rubbish.pt").write_bytes(pickle.dumps(3)[:2])
    with pytest.raises(ValueError, match="cannot read it"):
        checkpoint.load(tmp_path / "rubbish.pt")
    torch.save({"format": 0}, tmp_path / "old.pt")
    with pytest.raises(ValueError, match="must be a checkpoint of format 7, got 0"):
        checkpoint.load(tmp_path / "old.pt")


def test_checkpoint_of_another_robot_or_actor_is_refused(tmp_path):
    actor = torch.nn.Linear(2, 3)
    content = {"robot": "zeroth01", "actor": actor.state_dict()}
    checkpoint.check_fits(content, "zeroth01", actor, tmp_path)
    with pytest.raises(ValueError, match="must be of the robot icub, it is of zeroth01"):
        checkpoint.check_fits(content, "icub", actor, tmp_path)
    with pytest.raises(ValueError, match=r"weight has shape \(3, 2\) there and \(3, 4\) here"):
        checkpoint.check_fits(content, "zeroth01", torch.nn.Linear(4, 3), tmp_path)
