"""Checkpoints: whole, safe, and refused when they do not fit."""

import errno
import io
import pickle
import random
import zipfile
from collections import OrderedDict
from pathlib import Path

import pytest
import torch
from hydra.errors import InstantiationException

from zfall import checkpoint
from zfall.policies.load import POLICIES

CONFIG = "env:\n  num_envs: 8\nactor:\n  components: 3\n"
CONTENT = {
    "config": CONFIG,
    "robot": "zeroth01",
    "actor": OrderedDict(w=torch.arange(3.0), n=torch.tensor(7)),
    "policy": {"w": torch.tensor([[True, False]])},
    "frames": 7,
    "recent": [(0.0, 1.5), None, "text"],
}


def equal(one: object, other: object) -> bool:
    """Whether two contents are the same, down to the bits of tensors."""
    if isinstance(one, torch.Tensor):
        return isinstance(other, torch.Tensor) and torch.equal(one, other)
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(v, other[k]) for k, v in one.items())
    return type(one) is type(other) and one == other


def refusal(path: Path, **kwargs: object) -> str:
    """The one line with which a file is refused."""
    with pytest.raises(ValueError, match="must") as caught:
        checkpoint.load(path, **kwargs)
    text = str(caught.value)
    assert str(path) in text
    assert "\n" not in text
    assert "weights_only" not in text
    return text


def test_what_is_saved_is_loaded(tmp_path):
    path = tmp_path / "a.pt"
    checkpoint.save(path, CONTENT)
    content = checkpoint.load(path)
    assert equal(content, {"format": checkpoint.FORMAT, **CONTENT})
    assert [p.name for p in tmp_path.iterdir()] == ["a.pt"]


def test_crash_while_writing_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    checkpoint.save(path, {"frames": 1})

    def dies(handle: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("os.fsync", dies)
    with pytest.raises(KeyboardInterrupt):
        checkpoint.save(path, {"frames": 2})
    monkeypatch.undo()
    assert checkpoint.load(path, {})["frames"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.pt"]


class Full(io.FileIO):
    """A file on a disk that takes a hundred bytes more."""

    def write(self, data: object) -> int:
        super().write(memoryview(data)[:100])
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    checkpoint.save(path, {"frames": 1})
    monkeypatch.setattr(Path, "open", lambda self, mode: Full(self, mode.replace("b", "")))
    with pytest.raises(OSError, match=r"a\.pt must be writable: No space left") as caught:
        checkpoint.save(path, {"frames": 2})
    monkeypatch.undo()
    assert "\n" not in str(caught.value)
    assert checkpoint.load(path, {})["frames"] == 1
    assert [p.name for p in tmp_path.iterdir()] == ["a.pt"]


def test_a_link_in_the_place_of_the_temporary_file_is_not_followed(tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "a.tmp").symlink_to(tmp_path / "mine")
    checkpoint.save(tmp_path / "a.pt", {"frames": 1})
    assert (tmp_path / "mine").read_text() == "mine"
    assert checkpoint.load(tmp_path / "a.pt", {})["frames"] == 1


class Evil:
    def __reduce__(self) -> tuple:
        return (open, ("executed", "w"))


def test_code_in_a_checkpoint_is_not_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"format": checkpoint.FORMAT, **CONTENT, "x": Evil()}, tmp_path / "evil.pt")
    refusal(tmp_path / "evil.pt")
    (tmp_path / "plain.pt").write_bytes(pickle.dumps(Evil()))
    refusal(tmp_path / "plain.pt")
    assert not (tmp_path / "executed").exists()


def test_missing_file_rubbish_and_old_formats_are_refused(tmp_path):
    assert "there is no such file" in refusal(tmp_path / "no.pt")
    (tmp_path / "rubbish.pt").write_bytes(pickle.dumps(3)[:2])
    assert "damaged or of another kind" in refusal(tmp_path / "rubbish.pt")
    torch.save({"format": 0}, tmp_path / "old.pt")
    assert "must be a checkpoint of format 7, got 0" in refusal(tmp_path / "old.pt")
    torch.save([1, 2], tmp_path / "list.pt")
    assert "of another kind" in refusal(tmp_path / "list.pt")


def test_a_small_file_that_unpacks_to_a_huge_one_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "bomb.pt", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("bomb/data.pkl", bytes(10_000_000))
    assert "another kind" in refusal(tmp_path / "bomb.pt")


@pytest.mark.parametrize("digest", [True, False])
def test_a_flipped_bit_anywhere_changes_nothing_or_is_refused(tmp_path, digest):
    path = tmp_path / "a.pt"
    if digest:
        checkpoint.save(path, CONTENT)
    else:  # as earlier versions wrote it
        torch.save({"format": checkpoint.FORMAT, **CONTENT}, path)
    whole, sound = path.read_bytes(), checkpoint.load(path)
    positions, refused = random.Random(0).sample(range(len(whole)), 150), 0
    for position in positions:
        flipped = bytearray(whole)
        flipped[position] ^= 1 << position % 8
        path.write_bytes(flipped)
        try:
            content = checkpoint.load(path)
        except ValueError as error:
            refused += 1
            assert str(path) in str(error)
            assert "\n" not in str(error)
        else:
            assert equal(content, sound)
    assert refused > 30  # the others hit what fills up between the entries


def test_content_that_is_not_what_was_written_is_refused(tmp_path):
    digest = checkpoint.content_digest(CONTENT)
    for changed in (
        {"frames": 8},
        {"frames": 7.0},
        {"robot": "zeroth02"},
        {"policy": {"w": torch.tensor([[True, True]])}},
        {"policy": {"w": torch.tensor([True, False])}},
        {"actor": {"w": torch.arange(3.0).double(), "n": torch.tensor(7)}},
        {"recent": [(0.0, 1.5), "text", None]},
        {"more": 1},
    ):
        content = {"format": checkpoint.FORMAT, **CONTENT, **changed, "digest": digest}
        torch.save(content, tmp_path / "a.pt")
        assert "must be as it was written, it is damaged" in refusal(tmp_path / "a.pt")


@pytest.mark.parametrize("key", list(checkpoint.POLICY))
def test_a_missing_key_and_a_value_of_another_kind_are_named(tmp_path, key):
    lacking = {k: v for k, v in CONTENT.items() if k != key}
    checkpoint.save(tmp_path / "a.pt", lacking)
    assert f"must hold {key}, it lacks it" in refusal(tmp_path / "a.pt")
    checkpoint.save(tmp_path / "a.pt", lacking | {key: 3})
    assert f"{key} must be a t" in (text := refusal(tmp_path / "a.pt"))
    assert "got int" in text


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("part", ["actor", "policy", "critic", "optimizer"])
def test_weights_that_are_no_numbers_are_neither_read_nor_written(tmp_path, part, value):
    path = tmp_path / "a.pt"
    broken = {"state": {0: {"w": torch.tensor([1.0, value])}}} if part == "optimizer" else {
        "net.w": torch.tensor([1.0, value], dtype=torch.float64)
    }  # fmt: skip
    torch.save({"format": checkpoint.FORMAT, **CONTENT, part: broken}, path)
    text = refusal(path)
    assert f"{part}." in text
    assert f"w must be finite, got {value}" in text
    checkpoint.save(path, CONTENT)
    with pytest.raises(ValueError, match=rf"a\.pt: {part}\..*w must be finite"):
        checkpoint.save(path, CONTENT | {part: broken})
    assert equal(checkpoint.load(path)["actor"], CONTENT["actor"])


def test_what_envs_and_figures_hold_may_be_infinite(tmp_path):
    state = {
        "worlds": [{"least": torch.tensor([torch.inf])}],
        "run": {"kl": torch.tensor(torch.nan)},
    }
    checkpoint.save(tmp_path / "a.pt", CONTENT | state)
    assert checkpoint.load(tmp_path / "a.pt")["worlds"][0]["least"].isinf()


def test_a_key_that_going_on_needs_is_named(tmp_path):
    checkpoint.save(tmp_path / "a.pt", CONTENT)
    assert "must hold critic" in refusal(tmp_path / "a.pt", kinds=checkpoint.TRAINING)


def test_weights_that_do_not_fit_are_refused_in_one_line(tmp_path):
    with (
        pytest.raises(ValueError, match="must fit what reads it: lacks 'w'") as caught,
        checkpoint.reading(tmp_path / "a.pt"),
    ):
        {}["w"]
    assert str(tmp_path / "a.pt") in str(caught.value)
    with pytest.raises(ValueError, match="must fit") as caught, checkpoint.reading(tmp_path):
        torch.nn.Linear(2, 3).load_state_dict({"weight": torch.zeros(1)})
    assert "\n" not in str(caught.value)


def test_policies_that_ship_have_no_digest_and_are_read():
    content = torch.load(POLICIES / "best.pt", weights_only=True)
    assert equal(dict(checkpoint.load(POLICIES / "best.pt")["actor"]), dict(content["actor"]))


def test_checkpoint_of_another_robot_or_actor_is_refused(tmp_path):
    actor = torch.nn.Linear(2, 3)
    content = {"robot": "zeroth01", "actor": actor.state_dict()}
    checkpoint.check_fits(content, "zeroth01", actor, tmp_path)
    with pytest.raises(ValueError, match="must be of the robot icub, it is of zeroth01"):
        checkpoint.check_fits(content, "icub", actor, tmp_path)
    with pytest.raises(ValueError, match=r"weight has shape \(3, 2\) there and \(3, 4\) here"):
        checkpoint.check_fits(content, "zeroth01", torch.nn.Linear(4, 3), tmp_path)


def _nested(levels: int) -> list[object]:
    nested: list[object] = [1]
    for _ in range(levels):
        nested = [nested, nested]
    return nested


@pytest.mark.parametrize(
    "bomb", [torch.zeros(1).expand(10**12), _nested(40)], ids=["a terabyte", "2^40 entries"]
)
def test_a_small_file_that_stands_for_much_is_refused_at_once(tmp_path, bomb):
    path = tmp_path / "a.pt"
    torch.save({"format": checkpoint.FORMAT, **CONTENT, "more": bomb}, path)
    assert "damaged or of another kind" in refusal(path)


def test_what_hydra_says_of_a_config_that_does_not_fit_is_one_line_with_the_file():
    with pytest.raises(ValueError, match=r"^a\.pt: actor: it is too small") as caught:  # noqa: SIM117
        with checkpoint.reading(Path("a.pt")):
            raise InstantiationException("it is too small\nfull_key: actor")
    assert "\n" not in str(caught.value)
